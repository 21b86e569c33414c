"""The linear programs against a search over a fine grid of velocities."""

import pytest
import torch

from diffstack_mmv.simulation.pedestrians.half_planes import HalfPlanes, det
from diffstack_mmv.simulation.pedestrians.linear_program import nearest_velocity, safest_velocity


def planes_of(agents, lines):
    angle = 6.283 * torch.rand(agents, lines, dtype=torch.float64)
    direction = torch.stack((angle.cos(), angle.sin()), dim=-1)
    point = 0.6 * torch.randn(agents, lines, 2, dtype=torch.float64)
    return HalfPlanes(point, direction, torch.ones(agents, lines, dtype=torch.bool))


def violation(planes, velocity):
    """How deep a velocity lies in the forbidden side of the worst plane."""
    depth = det(planes.direction, planes.point - velocity[..., None, :])
    return depth.masked_fill(~planes.valid, -torch.inf).amax(dim=-1)


@pytest.fixture(scope="module")
def grid():
    axis = torch.linspace(-1, 1, 161, dtype=torch.float64)
    points = torch.cartesian_prod(axis, axis)
    return points[points.norm(dim=-1) <= 1]


@pytest.mark.parametrize("lines", [1, 3, 6])
def test_feasible_optimum_is_permitted_and_no_grid_point_is_nearer(grid, lines):
    planes, preferred = (
        planes_of(60, lines),
        torch.randn(60, 2, dtype=torch.float64).clamp(-0.7, 0.7),
    )
    found = nearest_velocity(planes, torch.ones(60, dtype=torch.float64), preferred)
    solved = found.failed_line == lines
    assert solved.sum() > 5
    assert (violation(planes, found.velocity)[solved] < 1e-6).all()
    expanded = HalfPlanes(planes.point[:, None], planes.direction[:, None], planes.valid[:, None])
    permitted = violation(expanded, grid.expand(60, -1, 2)) <= 0
    distance = (grid - preferred[:, None]).norm(dim=-1).masked_fill(~permitted, torch.inf)
    nearest = (found.velocity - preferred).norm(dim=-1)
    assert (nearest <= distance.amin(dim=-1) + 1e-9)[solved].all()


@pytest.mark.parametrize("lines", [3, 6, 10])
def test_infeasible_programs_violate_no_plane_more_than_the_best_grid_point(grid, lines):
    planes, preferred = planes_of(80, lines), torch.zeros(80, 2, dtype=torch.float64)
    limit = torch.ones(80, dtype=torch.float64)
    failed = nearest_velocity(planes, limit, preferred).failed_line < lines
    velocity = safest_velocity(planes, limit, preferred)
    expanded = HalfPlanes(planes.point[:, None], planes.direction[:, None], planes.valid[:, None])
    best = violation(expanded, grid.expand(80, -1, 2)).amin(dim=-1)
    assert failed.sum() > 3
    assert (velocity.norm(dim=-1) <= 1 + 1e-9).all()
    assert (violation(planes, velocity) <= best.clamp(min=0) + 1e-3)[failed].all()


def test_without_lines_the_preferred_velocity_is_only_cut_to_the_top_speed():
    preferred = torch.tensor([[0.3, 0.0], [3.0, 4.0]])
    velocity = safest_velocity(planes_of(2, 0), torch.ones(2), preferred)
    assert torch.allclose(velocity, torch.tensor([[0.3, 0.0], [0.6, 0.8]]))


def degenerate(planes):
    direction = planes.direction.clone()
    direction[:, :2] = torch.nan
    return planes._replace(direction=direction)


def not_valid(planes):
    return planes._replace(valid=torch.arange(5).expand(40, 5) < 3)


@pytest.mark.parametrize(("spoilt", "rest"), [(degenerate, slice(2, None)), (not_valid, slice(3))])
def test_planes_that_are_none_forbid_nothing(spoilt, rest):
    planes = planes_of(40, 5)
    alone = HalfPlanes(*(field[:, rest] for field in planes))
    preferred, limit = torch.randn(40, 2, dtype=torch.float64), torch.ones(40, dtype=torch.float64)
    expected = safest_velocity(alone, limit, preferred)
    assert torch.equal(safest_velocity(spoilt(planes), limit, preferred), expected)
