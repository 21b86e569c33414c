"""The cost of plans of the same problems is that of the planner, prepared once, with gradients."""

import torch

from diffstack_mmv.control.native import prices
from diffstack_mmv.control.native.capture import Recorder
from diffstack_mmv.planning import DetourFan
from diffstack_mmv.planning.plan_costs import PlanCosts
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
        found = PlanCosts(planner, problems, True, False)(*given)
        expected = PlanCosts(planner, problems, False, False)(*given)
    torch.testing.assert_close(found, expected, rtol=2e-5, atol=2e-4)


def test_a_problem_too_long_for_a_library_leaves_it_to_others(monkeypatch, caplog):
    monkeypatch.setattr(prices, "LONGEST_SOURCE", 0)
    planner = training()
    with torch.no_grad():
        motion, controls = plans(planner, problem())
        with caplog.at_level("INFO"):
            long = PlanCosts(planner, crowded(problem(), 7), True, False)
            long(motion, controls)
        monkeypatch.undo()
        short = PlanCosts(planner, problem(), True, False)
        short(motion, controls)
    assert "takes too long" in caplog.text
    assert long._prices is None
    assert short._prices is not None


def test_a_problem_is_taken_down_once_for_all_its_plans(monkeypatch):
    calls, taken_down = [], Recorder.__call__

    def counted(self, *arguments):
        calls.append(1)
        return taken_down(self, *arguments)

    monkeypatch.setattr(Recorder, "__call__", counted)
    planner, problems = training(), problem()
    with torch.no_grad():
        motion, controls = plans(planner, problems)
        costs = PlanCosts(planner, problems, True, False)
        first = costs(motion, controls)
        few = map_tensors(lambda entry: entry[:, 3:5], motion)
        again = costs(few, controls[:, 3:5])
    assert len(calls) == 1
    assert torch.equal(again, first[:, 3:5])


def test_plans_that_carry_a_gradient_get_it_after_others_that_do_not():
    planner, problems = training(), problem()
    with torch.no_grad():
        motion, controls = plans(planner, problems)
    costs = PlanCosts(planner, problems, True, True)
    costs(motion, controls)
    moved = motion._replace(position=motion.position.clone().requires_grad_())
    (slope,) = torch.autograd.grad(costs(moved, controls).sum(), moved.position)
    (right,) = torch.autograd.grad(
        PlanCosts(planner, problems, False, True)(moved, controls).sum(), moved.position
    )
    torch.testing.assert_close(slope, right)
    assert slope.abs().sum() > 0


def test_plans_without_a_library_cost_the_same_in_any_number_of_dimensions():
    planner, problems = training(), problem()
    with torch.no_grad():
        motion, controls = plans(planner, problems)
        whole = PlanCosts(planner, problems, False, False)(motion, controls)
        own = (map_tensors(lambda entry: entry[0], each) for each in (problems, motion, controls))
        alone, motion, controls = own
        found = PlanCosts(planner, alone, True, False)(motion, controls)
    torch.testing.assert_close(found, whole[0])
