"""Eliminating the tracks is exact."""

import pytest
import torch

from diffstack_mmv.identification.shooting.block_arrowhead import (
    BlockArrowhead,
    StepBounds,
    bounded_newton_step,
    eliminate_tracks,
    solve_arrowhead,
)

TRACKS, LOCAL, SHARED = 3, 5, 4


@pytest.fixture
def system():
    jacobian = torch.randn(TRACKS, 12, LOCAL + SHARED)
    local, cross = jacobian[..., :LOCAL], jacobian[..., LOCAL:]
    residual = torch.randn(TRACKS, 12, 1)
    return BlockArrowhead(
        local.mT @ local,
        local.mT @ cross,
        (cross.mT @ cross).sum(0),
        (local.mT @ residual).squeeze(-1),
        (cross.mT @ residual).sum((0, 2)),
    )


def dense(system):
    size = TRACKS * LOCAL
    matrix = torch.zeros(size + SHARED, size + SHARED)
    for track in range(TRACKS):
        rows = slice(track * LOCAL, (track + 1) * LOCAL)
        matrix[rows, rows] = system.local[track]
        matrix[rows, size:] = system.cross[track]
        matrix[size:, rows] = system.cross[track].mT
    matrix[size:, size:] = system.shared
    return matrix, torch.cat([system.local_gradient.flatten(), system.shared_gradient])


def test_schur_complement_is_the_inverse_of_the_marginal_covariance(system):
    covariance = torch.linalg.inv(dense(system)[0])[-SHARED:, -SHARED:]
    torch.testing.assert_close(torch.linalg.inv(eliminate_tracks(system).information), covariance)


def test_step_solves_the_whole_system(system):
    matrix, gradient = dense(system)
    step = solve_arrowhead(system)
    whole = torch.cat([step.local.flatten(), step.shared])
    torch.testing.assert_close(matrix @ whole, -gradient)


def test_scaling_changes_the_unit_of_the_step_only(system):
    factor = torch.tensor([1e-6, 1.0, 10.0, 1e5])
    scaled = solve_arrowhead(system.scaled(factor))
    torch.testing.assert_close(
        scaled.shared * factor, solve_arrowhead(system).shared, rtol=1e-6, atol=0.0
    )
    torch.testing.assert_close(scaled.local, solve_arrowhead(system).local)


def test_restriction_holds_the_other_parameters(system):
    active = torch.tensor([True, False, True, False])
    step = solve_arrowhead(system.restricted(active)).shared
    information, gradient = eliminate_tracks(system)
    torch.testing.assert_close(
        information[active][:, active] @ step, -gradient[active], rtol=1e-8, atol=1e-10
    )


def test_bounded_step_is_the_minimum_inside_the_box(system):
    reduced = eliminate_tracks(system)
    box = StepBounds(torch.full((SHARED,), -0.05), torch.full((SHARED,), 0.05))
    step = bounded_newton_step(reduced, box)
    slope = reduced.information @ step + reduced.gradient
    lower, upper = step <= -0.05, step >= 0.05
    assert bool((lower | upper).any())
    assert bool((slope[~lower & ~upper].abs() < 1e-9).all())
    assert bool((step.abs() <= 0.05).all())


def test_bounds_that_do_not_bind_change_nothing(system):
    wide = StepBounds(torch.full((SHARED,), -1e3), torch.full((SHARED,), 1e3))
    torch.testing.assert_close(solve_arrowhead(system, wide).shared, solve_arrowhead(system).shared)


def test_damping_shortens_the_step(system):
    damped = solve_arrowhead(system.damped(torch.full((TRACKS,), 10.0), torch.tensor(10.0)))
    assert float(damped.local.norm()) < float(solve_arrowhead(system).local.norm())
