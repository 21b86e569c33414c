"""The cost of plans of the same problems is that of the planner, prepared once, with gradients."""

from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from diffstack_mmv.control.native import prices
from diffstack_mmv.control.native.capture import Recorder
from diffstack_mmv.planning import DetourFan, plan_costs
from diffstack_mmv.planning.plan_costs import PreparedCost
from diffstack_mmv.types import map_tensors
from tests.planning.test_planner import STEPS, problem, training


def plans(planner, problems):
    fan = DetourFan()(planner.dynamics, problems, STEPS)
    return fan.motion, fan.controls


def crowded(problems, components):
    """The problems with an agent that may walk off in so many ways."""
    agents = problems.obstacles
    ways = torch.randn(*agents.valid.shape, components, STEPS + 1, 2)
    several = agents._replace(
        position=agents.position[..., :1, :, :] + ways,
        weight=agents.weight.new_full((*agents.valid.shape, components), 1 / components),
    )
    return problems._replace(obstacles=several)


def test_a_library_costs_what_tensors_cost():
    planner, problems = training(), crowded(problem(), 5)
    with torch.no_grad():
        given = plans(planner, problems)
        found = PreparedCost(planner, problems, True, False)(*given)
        expected = PreparedCost(planner, problems, False, False)(*given)
    torch.testing.assert_close(found, expected, rtol=2e-5, atol=2e-4)


def test_no_problem_costs_nothing_with_a_library_as_without():
    planner = training()
    none = map_tensors(lambda entry: entry[:0], crowded(problem(), 5))
    cost = PreparedCost(planner, none, True, False)(*plans(planner, none))
    assert cost.shape == (0, len(DetourFan().detour.offset) + 1, STEPS + 1)


def test_impossible_components_do_not_change_what_a_library_costs():
    """The collision term takes an agent by its expected distance, not component by component."""
    planner, problems = training(), crowded(problem(), 5)
    weight = torch.tensor([0.0, 0.25, 0.25, 0.25, 0.25])
    agents = problems.obstacles
    problems = problems._replace(
        obstacles=agents._replace(weight=weight.expand_as(agents.weight).clone())
    )
    with torch.no_grad():
        given = plans(planner, problems)
        found = PreparedCost(planner, problems, True, False)(*given)
        expected = PreparedCost(planner, problems, False, False)(*given)
    torch.testing.assert_close(found, expected, rtol=2e-5, atol=2e-4)


def test_a_problem_too_long_for_a_library_leaves_it_to_others(monkeypatch, caplog):
    monkeypatch.setattr(prices, "LONGEST_SOURCE", 0)
    planner = training()
    with torch.no_grad():
        motion, controls = plans(planner, problem())
        long = crowded(problem(), 7)
        with caplog.at_level("INFO"):
            found = PreparedCost(planner, long, True, False)(motion, controls)
            assert "takes too long" in caplog.text
            caplog.clear()
            monkeypatch.undo()
            PreparedCost(planner, problem(), True, False)(motion, controls)
            assert "takes too long" not in caplog.text
        expected = PreparedCost(planner, long, False, False)(motion, controls)
    assert torch.equal(found, expected)


def test_a_problem_is_taken_down_once_for_all_its_plans(monkeypatch):
    calls, taken_down = [], Recorder.__call__

    def counted(self, *arguments):
        calls.append(1)
        return taken_down(self, *arguments)

    monkeypatch.setattr(Recorder, "__call__", counted)
    planner, problems = training(), problem()
    with torch.no_grad():
        motion, controls = plans(planner, problems)
        costs = PreparedCost(planner, problems, True, False)
        first = costs(motion, controls)
        few = map_tensors(lambda entry: entry[:, 3:5], motion)
        again = costs(few, controls[:, 3:5])
    assert len(calls) == 1
    assert torch.equal(again, first[:, 3:5])


def test_plans_that_carry_a_gradient_get_it_after_others_that_do_not():
    planner, problems = training(), problem()
    with torch.no_grad():
        motion, controls = plans(planner, problems)
    costs = PreparedCost(planner, problems, True, True)
    costs(motion, controls)
    moved = motion._replace(position=motion.position.clone().requires_grad_())
    (slope,) = torch.autograd.grad(costs(moved, controls).sum(), moved.position)
    (right,) = torch.autograd.grad(
        PreparedCost(planner, problems, False, True)(moved, controls).sum(), moved.position
    )
    torch.testing.assert_close(slope, right)
    assert slope.abs().sum() > 0


def test_plans_without_a_library_cost_the_same_in_any_number_of_dimensions():
    planner, problems = training(), problem()
    with torch.no_grad():
        motion, controls = plans(planner, problems)
        whole = PreparedCost(planner, problems, False, False)(motion, controls)
        own = (map_tensors(lambda entry: entry[0], each) for each in (problems, motion, controls))
        alone, motion, controls = own
        found = PreparedCost(planner, alone, True, False)(motion, controls)
    torch.testing.assert_close(found, whole[0])


class Around(NamedTuple):
    """Stand-in for a problem."""

    obstacles: NamedTuple


class Agents(NamedTuple):
    """Stand-in for obstacles."""

    position: Tensor


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("graded", [True, False])
def test_costs_in_parts_are_those_of_the_whole(monkeypatch, graded):
    motion, controls = torch.randn(5, 3, 2, 4), torch.randn(5, 3, 4, 2)
    position = torch.randn(5, 1, 2, 1, 4, 2, requires_grad=graded)
    monkeypatch.setattr(plan_costs, "LARGEST", 24)

    def counted(motion, controls, problem):
        assert len(motion) <= 1
        away = motion - problem.obstacles.position[:, :, :, 0, :, 0]
        return away.square().sum(-2) + controls.sum(-1)

    problem = Around(Agents(position))
    found = plan_costs.cost_in_parts(counted, motion, controls, problem)
    away = motion - position[:, :, :, 0, :, 0]
    expected = away.square().sum(-2) + controls.sum(-1)
    assert torch.equal(found, expected)
    if graded:
        first, second = (torch.autograd.grad(each.sum(), position)[0] for each in (found, expected))
        assert torch.allclose(first, second)
