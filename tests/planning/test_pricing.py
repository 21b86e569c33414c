"""What plans are worth."""

from dataclasses import fields

import pytest
import torch

from diffstack_mmv.planning import (
    ClearanceMargin,
    CostScore,
    PlanPrice,
    Plans,
    ScoredPlans,
    Situation,
    clearance_within_steps,
)
from diffstack_mmv.types import (
    Discs,
    Ego,
    HeadingOf,
    Motion,
    Obstacles,
    PlanningProblem,
    map_tensors,
)


def along_y(goal, agent=2.0, steps=12):
    """A plan of 3 m along y in 3 s, and an agent that stands on its way."""
    along = torch.linspace(0, 3, steps + 1)
    flat = torch.zeros_like(along)
    velocity = torch.stack([flat + 1, flat], -1)
    motion = Motion(torch.stack([flat, along], -1), flat + torch.pi / 2, velocity, flat)
    standing = torch.tensor([0.0, agent]).expand(1, 1, 1, steps + 1, 2)
    one = torch.ones(1, 1)
    problem = PlanningProblem(
        Ego(
            Motion(*(entry[None, 0] for entry in motion)),
            HeadingOf.BODY,
            Discs(torch.zeros(1, 1), 0.3 * one),
        ),
        torch.tensor([[0.0, goal]]),
        torch.zeros(1, steps + 1, 2),
        torch.ones(1),
        Obstacles(standing, one[..., None], 0.3 * one, one > 0),
    )
    moved = map_tensors(lambda e: e[None, None], motion)
    return problem, Plans(torch.zeros(1, 1, steps, 2), moved)


def one_per_step(motion, controls):
    return torch.ones_like(motion.heading)


def waiting(problem, waited=0.0, cost=one_per_step):
    return Situation(problem, cost, torch.tensor([waited]), 0.25)


@pytest.mark.parametrize(("goal", "safe"), [(1.0, True), (8.0, False)])
def test_a_plan_is_refused_for_agents_before_its_arrival_alone(goal, safe):
    problem, plans = along_y(goal)
    priced = PlanPrice()(plans, waiting(problem))
    assert priced.safe.tolist() == [[safe]]


@pytest.mark.parametrize("compile", [False, True])
@pytest.mark.parametrize(("agent", "safe"), [(1.44, False), (1.46, True), (1.6, True)])
def test_the_step_after_the_arrival_is_no_part_of_the_way(agent, safe, compile):
    """Arrived at 0.75 m, within a quarter of a metre of the goal: 0.1 m of clearance are asked."""
    problem, plans = along_y(goal=0.9, agent=agent)
    margin = ClearanceMargin(hard_m=0.1, hard_growth=0.0)
    price = PlanPrice(margin, compile=compile)
    assert price(plans, waiting(problem)).safe.tolist() == [[safe]]


@pytest.mark.parametrize(("waited", "patience"), [(0.0, 1.0), (1.0, 0.5), (3.0, 0.125)])
def test_who_waits_cares_less_for_comfort_and_more_for_what_is_left(waited, patience):
    problem, plans = along_y(goal=8.0, agent=30.0)
    price = PlanPrice(time_weight=0.0, left_weight=10.0)
    priced = price(plans, waiting(problem, waited))
    assert float(priced.cost) == pytest.approx(13 + (1 - patience) * 10.0 * 5.0)


@pytest.mark.parametrize("patience_s", [0.5, 4.0])
def test_patience_halves_in_its_own_time(patience_s):
    problem, plans = along_y(goal=8.0, agent=30.0)
    price = PlanPrice(time_weight=0.0, left_weight=10.0, patience_s=patience_s)
    priced = price(plans, waiting(problem, 2 * patience_s))
    assert float(priced.cost) == pytest.approx(13 + 0.75 * 10.0 * 5.0)


@pytest.mark.parametrize("compile", [False, True])
def test_a_risk_is_paid_by_its_weight(compile):
    problem, plans = along_y(goal=8.0)
    free, paid = (
        PlanPrice(risk_weight=weight, compile=compile)(plans, waiting(problem))
        for weight in (0.0, 7.0)
    )
    motion, discs, agents = plans.motion, problem.ego.discs, problem.obstacles
    risk = ClearanceMargin().risk(clearance_within_steps(motion, discs, agents), agents, 0.25)
    assert float(risk) > 0.1
    assert float(paid.cost - free.cost) == pytest.approx(7.0 * float(risk), rel=1e-4)


@pytest.mark.parametrize("compile", [False, True])
@pytest.mark.parametrize("number", range(3))
def test_each_problem_of_a_batch_is_priced_by_itself(number, compile):
    def alone(record):
        return map_tensors(lambda entry: entry[number, None], record)

    problem, plans = map_tensors(lambda entry: torch.cat([entry] * 3), along_y(goal=8.0))
    problem.goal[:, 1] = torch.tensor([1.0, 2.0, 8.0])
    problem.obstacles.position[..., 0] += torch.tensor([0.1, 0.7, 9.0])[:, None, None, None]
    waited = torch.tensor([0.0, 1.0, 3.0])
    together = Situation(problem, one_per_step, waited, 0.25)
    found = PlanPrice(risk_weight=7.0, compile=compile)(plans, together)
    own = waiting(alone(problem), float(waited[number]))
    expected = PlanPrice(risk_weight=7.0)(alone(plans), own)
    torch.testing.assert_close(alone(found), expected)


def test_nothing_is_left_of_the_way_of_a_plan_that_passes_its_goal_and_goes_on():
    problem, plans = along_y(goal=2.0, agent=30.0)
    price = PlanPrice(time_weight=0.0, left_weight=10.0)
    priced = price(plans, waiting(problem, 3.0))
    assert float(priced.cost) == pytest.approx(9)  # the times up to the arrival


def test_a_plan_that_is_not_finite_is_never_chosen():
    problem, plans = along_y(goal=8.0)
    lost = plans.motion._replace(position=plans.motion.position * torch.nan)
    priced = PlanPrice()(plans._replace(motion=lost), waiting(problem))
    assert priced.cost.isinf().all()
    assert not priced.safe.any()


def test_the_cost_alone_carries_a_gradient_and_calls_every_plan_safe():
    problem, plans = along_y(goal=8.0)
    weight = torch.ones((), requires_grad=True)

    def cost(motion, controls):
        return weight * one_per_step(motion, controls)

    scored = CostScore()(plans, waiting(problem, cost=cost))
    assert scored.safe.all()
    assert torch.autograd.grad(scored.cost.sum(), weight)[0].item() == 13
    assert not PlanPrice()(plans, waiting(problem, cost=cost)).cost.requires_grad


@pytest.mark.parametrize(
    ("cost", "safe", "shortfall", "best"),
    [
        ([3.0, 1.0, 2.0], [True, True, True], [0.0, 0.0, 0.0], 1),
        ([3.0, 1.0, 2.0], [True, False, True], [0.0, 0.1, 0.0], 2),
        ([3.0, 1.0, 2.0], [False, False, False], [0.1, 0.5, 0.3], 0),
        ([3.0, 1.0, torch.inf], [False, False, False], [0.2, 0.2, torch.inf], 1),
    ],
)
def test_the_best_is_the_cheapest_safe_or_the_least_unsafe(cost, safe, shortfall, best):
    _, one = along_y(goal=8.0)
    plans = ScoredPlans(
        map_tensors(lambda entry: entry.expand(1, 3, *entry.shape[2:]), one),
        torch.tensor([cost]),
        torch.tensor([safe]),
        torch.tensor([shortfall]),
    )
    assert plans.best().tolist() == [best]
    twice = plans.beside(plans)
    assert twice.cost.shape == (1, 6)
    assert twice.plans.motion.heading.shape == (1, 6, 13)


NUMBERS = [field.name for field in fields(PlanPrice) if field.type is float]


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_out_of_range_are_refused(name):
    with pytest.raises(ValueError, match=name):
        PlanPrice(**{name: -1.0})


def test_a_plan_without_a_finite_cost_is_not_safe():
    problem, plans = along_y(3.0)

    def diverged(motion, controls):
        return torch.full(motion.heading.shape, torch.nan)

    scored = CostScore()(plans, Situation(problem, diverged, torch.zeros(1), 0.25))
    assert scored.cost.isinf().all()
    assert not scored.safe.any()
