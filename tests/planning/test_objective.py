"""Problems and motions as the tensors that a solver selects from."""

import pytest
import torch

from diffstack_mmv.planning.clearance import disc_centres
from diffstack_mmv.planning.objective import NAMES, joined, motion_rows, parted
from diffstack_mmv.types import Discs, Ego, HeadingOf, Motion, Obstacles, PlanningProblem


def motion_of(*shape):
    return Motion(
        torch.randn(*shape, 2), torch.randn(*shape), torch.randn(*shape, 2), torch.randn(*shape)
    )


def problem_of(heading_of):
    """Two problems with numbers of their own in every tensor."""
    discs = Discs(torch.randn(2, 3), torch.rand(2, 3))
    valid = torch.tensor([[True, False]] * 2)
    obstacles = Obstacles(torch.randn(2, 2, 1, 5, 2), torch.rand(2, 2, 1), torch.rand(2, 2), valid)
    ego = Ego(motion_of(2), heading_of, discs)
    return PlanningProblem(ego, torch.randn(2, 2), torch.randn(2, 5, 2), torch.rand(2), obstacles)


@pytest.mark.parametrize("heading_of", list(HeadingOf))
def test_a_problem_is_that_of_its_parts(heading_of):
    problem = problem_of(heading_of)
    again = joined(heading_of, parted(problem))
    assert again.ego.heading_of is heading_of
    for one, other in zip(parted(problem), parted(again), strict=True):
        assert one is other


def test_every_part_of_a_problem_has_a_name():
    problem = problem_of(HeadingOf.COURSE)
    named = dict(zip(NAMES, parted(problem), strict=True))
    assert named["goal"] is problem.goal
    assert named["yaw_rate"] is problem.ego.motion.yaw_rate
    assert named["ego_disc_radius"] is problem.ego.discs.radius
    assert named["obstacle_weight"] is problem.obstacles.weight


def test_rows_of_a_motion_are_place_course_velocity_and_yaw_rate():
    motion = motion_of(2, 4)
    position, course, velocity, yaw_rate = motion_rows(motion).split([2, 1, 2, 1], -1)
    assert torch.equal(position, motion.position)
    assert torch.equal(course[..., 0], motion.heading)
    assert torch.equal(velocity, motion.velocity)
    assert torch.equal(yaw_rate[..., 0], motion.yaw_rate)


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.5])
def test_discs_lie_ahead_of_and_behind_the_reference_point_on_the_axis(heading):
    motion = motion_of(1, 3)._replace(heading=torch.full((1, 3), heading))
    ahead = torch.tensor([-0.5, 0.0, 1.5])
    centres = disc_centres(motion, Discs(ahead, torch.ones(3)))
    assert centres.shape == (1, 3, 3, 2)
    assert torch.equal(centres[0, 1], motion.position[0])
    forward = torch.tensor([heading]).cos(), torch.tensor([heading]).sin()
    expected = motion.position + ahead[:, None, None] * torch.cat(forward)
    assert torch.allclose(centres[0], expected, atol=1e-6)
