"""Where the ego is expected to go once its goal is known."""

import math

import pytest
import torch

from diffstack_mmv.planning import FutureGoal, PredictedGoal, WantedGoal, predicted_reference
from diffstack_mmv.planning.conditional import given_end
from diffstack_mmv.planning.problem import bent_to_goal
from diffstack_mmv.prediction import hermite_spline
from diffstack_mmv.types import Forecast, Motion
from tests.prediction.samples import scene

STEPS, DT_S = 30, 0.1


def forecast(*ends):
    """Straight ways of one agent from the origin, equally likely, with a spread of t²."""
    share = torch.arange(1, STEPS + 1) / STEPS
    mean = torch.tensor([ends]).unsqueeze(-2) * share.unsqueeze(-1)
    scale = 2.0 * share.square()[:, None, None] * torch.eye(2) + 0.02 * torch.eye(2)
    weight = torch.full((1, len(ends)), 1 / len(ends))
    return Forecast(weight.log(), mean, scale.expand(1, len(ends), STEPS, 2, 2))


def test_a_single_path_is_bent_to_the_goal_as_a_spline():
    """Constant velocity and a known end: the cubic Hermite spline of the baselines."""
    paths, goal = forecast([9.0, 0.0]), torch.tensor([[6.0, 3.0]])
    expected = FutureGoal().expected_path(paths, goal)
    still = torch.zeros(1, 2)
    now = Motion(still, still[:, 0], torch.tensor([[3.0, 0.0]]), still[:, 0])
    assert torch.allclose(expected, hermite_spline(now, goal, STEPS, DT_S), atol=1e-5)
    assert torch.equal(predicted_reference(now, expected, goal, DT_S).path[:, 1:], expected)


def test_of_several_paths_those_near_the_goal_count():
    paths, goal = forecast([9.0, 0.0], [6.0, 4.0], [6.0, -4.0]), torch.tensor([[6.2, 3.7]])
    expected = FutureGoal(steadiness=0.0).expected_path(paths, goal)
    told = given_end(paths, goal).median()
    assert (told - paths.mean[:, 1]).norm(dim=-1).max() < 0.5
    assert torch.allclose(expected, (told + bent_to_goal(paths.median(), goal)) / 2, atol=1e-6)
    assert torch.allclose(expected[:, -1], goal, atol=1e-3)


@pytest.mark.parametrize("steps", [1, 2, STEPS])
def test_the_steadiest_path_to_the_goal_is_the_straight_line(steps):
    paths, goal = forecast([9.0, 0.0], [6.0, 4.0], [6.0, -4.0]), torch.tensor([[6.2, 3.7]])
    paths = Forecast(paths.log_weight, paths.mean[:, :, :steps], paths.scale_tril[:, :, :steps])
    free, line, between = (
        FutureGoal(share).expected_path(paths, goal) for share in (0.0, 1.0, 0.25)
    )
    pieces = line.diff(dim=-2)
    assert torch.allclose(pieces, pieces[:, :1].expand_as(pieces), atol=1e-5)
    assert torch.allclose(line[:, -1], goal, atol=1e-5)
    if steps > 1:
        begins = [2 * path[:, 0] - path[:, 1] for path in (free, line)]
        assert torch.allclose(*begins, atol=1e-5)
    assert torch.allclose(between, 0.75 * free + 0.25 * line, atol=1e-5)


@pytest.mark.parametrize("steadiness", [-0.1, 1.5, math.nan])
def test_the_steadiness_is_a_share(steadiness):
    with pytest.raises(ValueError, match="`steadiness` must lie in"):
        FutureGoal(steadiness)


def test_a_wish_bends_the_path_and_not_its_start():
    paths, goal = forecast([9.0, 0.0], [6.0, 4.0], [6.0, -4.0]), torch.tensor([[60.0, 3.7]])
    expected = WantedGoal().expected_path(paths, goal)
    assert torch.equal(expected, paths.median())
    assert FutureGoal().expected_path(paths, goal)[0, 0, 0] > 1.2 * expected[0, 0, 0]


def test_the_predicted_goal_is_the_end_of_the_path_that_the_majority_takes():
    paths, goal = forecast([9.0, 0.0], [9.0, 0.0], [0.0, 9.0]), PredictedGoal()
    found = goal(scene(batch=(1,)), paths)
    torch.testing.assert_close(found, torch.tensor([[9.0, 0.0]]), atol=0.1, rtol=0)
    path = goal.expected_path(paths, found)
    assert torch.equal(path[:, -1], found)
    torch.testing.assert_close(path[:, 14], found / 2, atol=0.05, rtol=0)
