"""ORCA half-planes against the recorded steps of the RVO2 library."""

import numpy as np
import pytest
import torch

from diffstack_mmv.simulation.pedestrians.half_planes import (
    Agents,
    Neighbors,
    half_planes,
    nearest,
    normalise,
)
from diffstack_mmv.simulation.pedestrians.linear_program import (
    least_violation,
    nearest_velocity,
    safest_velocity,
)

KINDS = ("crowdnav", "mixed", "dense", "overlap", "symmetric", "far", "pref")


@pytest.fixture
def cases(recording):
    return recording("orca_unit_cases")


@pytest.fixture
def solve(cases):
    def run(kind):
        chosen = cases["kind"] == kind

        def single(name):
            return torch.from_numpy(cases[name][chosen]).float()

        columns = ("pos", "vel", "pref_vel", "radius", "max_speed")
        agents = Agents(*(single(name) for name in columns))
        present = torch.arange(20) < torch.from_numpy(cases["n_others"][chosen])[:, None]
        columns = ("other_pos", "other_vel", "other_radius")
        neighbors = Neighbors(*(single(name) for name in columns), present)
        count = torch.from_numpy(cases["max_neighbors"][chosen])
        found = nearest(agents, neighbors, single("neighbor_dist"), count)
        planes = half_planes(agents, found.neighbors, single("dt"), single("time_horizon"))
        return chosen, agents, found, planes

    return run


@pytest.mark.parametrize("kind", KINDS)
def test_neighbors_come_in_the_order_of_the_library(cases, solve, kind):
    chosen, _, found, _ = solve(kind)
    index = torch.where(found.neighbors.valid, found.index, -1).numpy()
    assert np.array_equal(index, cases["neighbor_ids"][chosen][:, : index.shape[1]])


@pytest.mark.parametrize("kind", KINDS)
def test_lines_equal_those_of_the_library_bit_for_bit(cases, solve, kind):
    chosen, _, found, planes = solve(kind)
    valid = found.neighbors.valid.numpy()
    width = valid.shape[1]
    for ours, theirs in ((planes.point, "line_point"), (planes.direction, "line_dir")):
        expected = cases[theirs][chosen][:, :width][valid]
        assert np.array_equal(ours.numpy()[valid], expected, equal_nan=True)


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_line_is_the_first_infeasible_one(cases, solve, kind):
    chosen, agents, _, planes = solve(kind)
    found = nearest_velocity(planes, agents.max_speed, agents.preferred_velocity)
    lines = planes.point.shape[1]
    failed = torch.where(found.failed_line == lines, -1, found.failed_line).numpy()
    assert np.array_equal(failed, cases["lp2_fail_line"][chosen])


@pytest.mark.parametrize("kind", KINDS)
def test_velocities_equal_those_of_the_library_bit_for_bit(cases, solve, kind):
    chosen, agents, _, planes = solve(kind)
    velocity = safest_velocity(planes, agents.max_speed, agents.preferred_velocity)
    assert np.array_equal(velocity.double().numpy(), cases["new_vel"][chosen])


def test_feasible_programs_are_left_alone_by_the_third_program(solve):
    _, agents, _, planes = solve("far")
    found = nearest_velocity(planes, agents.max_speed, agents.preferred_velocity)
    feasible = found.failed_line == planes.point.shape[1]
    velocity = least_violation(planes, agents.max_speed, found)
    assert feasible.any()
    assert torch.equal(velocity[feasible], found.velocity[feasible])


def test_the_unit_vector_of_zero_is_not_a_number():
    assert normalise(torch.zeros(2)).isnan().all()
