"""Cost weights learn from closed-loop episodes."""

import math

import pytest
import torch

from diffstack_mmv.control import ILQR
from diffstack_mmv.planning import TakeOptimum
from diffstack_mmv.simulation import DiscFootprint, imitation_loss, vehicle_robot, way_left_loss
from diffstack_mmv.types import map_tensors


@pytest.fixture
def setting(world_with, driven, scenario_of):
    world = world_with(vehicle_robot(driven(), footprint=DiscFootprint()), exact=True, limit_s=10.0)
    return world, scenario_of("circle").cases("train", range(2))


@pytest.fixture
def converging(controller_for):
    """A controller whose solves converge, with altered logarithms of its weights."""

    def build(**shifts):
        controller = controller_for(starts=1)
        controller.planner.solver = ILQR(max_iterations=60, tolerance=1e-5)
        controller.planner.choice = TakeOptimum()
        cost = controller.planner.cost
        with torch.no_grad():
            for name, shift in shifts.items():
                cost.log_weight[cost.learned.index(name)] += shift
        return controller

    return build


def test_who_acts_like_the_teacher_has_no_loss(setting, converging):
    loss = imitation_loss(*setting, converging(), converging(), 1)
    assert float(loss.detach()) < 1e-9


class Steady:
    """Acts alike at every step, one row of actions for each episode."""

    def __init__(self, *actions):
        self.actions = torch.tensor(actions, dtype=torch.float64)

    def init(self, observation):
        return 0

    def act(self, state, observation):
        return self.actions, state + 1


def test_imitation_is_the_mean_square_of_what_differs_by_the_largest_control(setting):
    world, scene = setting
    bounds = list(zip(*(bound.tolist() for bound in world.robot.bounds), strict=True))
    assert (-3.0, 2.0) in bounds
    own, taught = ([0.3, 0.2], [-0.1, 0.4]), ([-0.9, 0.25], [-0.1, -0.2])
    expected = [
        ((mine - theirs) / max(high, -low)) ** 2
        for rows in zip(own, taught, strict=True)
        for mine, theirs, (low, high) in zip(*rows, bounds, strict=True)
    ]
    for steps in (1, 3):
        loss = imitation_loss(world, scene, Steady(*own), Steady(*taught), steps)
        assert float(loss) == pytest.approx(sum(expected) / 4, rel=1e-5)


def test_the_way_left_is_the_mean_distance_from_where_the_steps_end(world_with, scenario_of):
    world, scene = world_with(exact=True), scenario_of("circle").cases("train", range(2))
    found = way_left_loss(world, scene, Steady([0.5, 1.0], [-0.2, 0.3]), 3)
    ends = scene.robot_position + 3 * 0.25 * torch.tensor([[0.5, 1.0], [-0.2, 0.3]]).double()
    away = [math.dist(*pair) for pair in zip(ends.tolist(), scene.robot_goal.tolist(), strict=True)]
    assert float(found) == pytest.approx(sum(away) / 2)


@pytest.mark.slow
def test_imitation_moves_the_weights_towards_the_teacher(setting, converging):
    teacher, learner = converging(), converging(effort=1.8)
    weight = learner.planner.cost.log_weight
    mask = torch.zeros_like(weight)
    mask[learner.planner.cost.learned.index("effort")] = 1
    losses = []
    for _ in range(5):  # the learner begins 1.8 away, in steps of 0.4
        loss = imitation_loss(*setting, learner, teacher, 3)
        (gradient,) = torch.autograd.grad(loss, weight)
        losses.append(float(loss.detach()))
        with torch.no_grad():
            weight -= 0.4 * mask * gradient.sign()
    assert losses[-1] < 0.1 * losses[0]


@pytest.mark.slow
def test_the_way_left_falls_along_its_gradient(setting, converging):
    learner = converging(effort=3.0)
    weight = learner.planner.cost.log_weight
    loss = way_left_loss(*setting, learner, 3)
    (gradient,) = torch.autograd.grad(loss, weight)
    assert bool(gradient.isfinite().all())
    with torch.no_grad():
        weight -= 0.5 * gradient / gradient.abs().max()
    assert float(way_left_loss(*setting, learner, 3).detach()) < float(loss.detach())


def test_whoever_stands_on_the_goal_has_a_finite_gradient(setting):
    """The root of the distance has none of its own there."""
    world, scene = setting
    scene = scene._replace(robot_goal=scene.robot_position)
    push = torch.zeros((), requires_grad=True)

    class Resting:
        def init(self, observation):
            return

        def act(self, state, observation):
            return push * torch.ones(len(observation.time), 2), None

    (gradient,) = torch.autograd.grad(way_left_loss(world, scene, Resting(), 1), push)
    assert bool(gradient.isfinite())


@pytest.mark.parametrize("loss", [imitation_loss, way_left_loss])
def test_no_step_is_refused(loss, setting, converging):
    world, scene = setting
    actors = [converging(), converging()] if loss is imitation_loss else [converging()]
    with pytest.raises(ValueError, match="steps"):
        loss(world, map_tensors(lambda entry: entry[:1], scene), *actors, 0)
