"""What every cost term must do, for all costs that `configs/` holds."""

from functools import cache

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

import diffstack_mmv.commands.cli  # noqa: F401  registers the resolvers
from diffstack_mmv.costs import WeightedCost
from diffstack_mmv.geometry import direction, rotate
from diffstack_mmv.types import (
    Discs,
    Ego,
    HeadingOf,
    Motion,
    Obstacles,
    PlanningProblem,
    map_tensors,
)
from diffstack_mmv.vehicles import config_folder

COSTS = sorted(path.stem for path in (config_folder() / "cost").glob("*.yaml"))
BATCH, TIMES = 3, 6


@cache
def build(name: str) -> WeightedCost:
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose(overrides=[f"+cost={name}", "+vehicle=bicycle"])
    return instantiate(config.cost).double()


TERMS = [(name, term) for name in COSTS for term in build(name).terms]
every_term = pytest.mark.parametrize(("name", "term"), TERMS)
every_cost = pytest.mark.parametrize("name", COSTS)


def random(*shape):
    return torch.randn(*shape, dtype=torch.float64)


@pytest.fixture
def case():
    """A motion, controls and a problem with two discs, four agents and two components."""
    torch.manual_seed(0)
    motion = Motion(
        random(BATCH, TIMES, 2),
        random(BATCH, TIMES),
        random(BATCH, TIMES, 2),
        random(BATCH, TIMES),
    )
    obstacles = Obstacles(
        random(BATCH, 4, 2, TIMES, 2),
        random(BATCH, 4, 2).softmax(-1),
        random(BATCH, 4).abs(),
        random(BATCH, 4) > -0.5,
    )
    now = Motion(*(entry[:, 0] for entry in motion))
    ego = Ego(now, HeadingOf.BODY, Discs(random(BATCH, 2), random(BATCH, 2).abs()))
    reference = random(BATCH, TIMES, 2)
    problem = PlanningProblem(ego, random(BATCH, 2), reference, random(BATCH).abs(), obstacles)
    controls = torch.cat([random(BATCH, TIMES - 1, 2), torch.zeros(BATCH, 1, 2).double()], 1)
    return motion, controls, problem


def moved(motion, problem, turn, shift):
    """The same scene elsewhere, turned."""

    def place(points):
        return rotate(points, turn.expand(points.shape[:-1])) + shift

    def go(motion):
        return motion._replace(position=place(motion.position), heading=motion.heading + turn)

    obstacles = problem.obstacles._replace(position=place(problem.obstacles.position))
    there = problem._replace(
        ego=problem.ego._replace(motion=go(problem.ego.motion)),
        goal=place(problem.goal),
        reference=place(problem.reference),
        obstacles=obstacles,
    )
    return go(motion), there


@every_term
def test_a_term_is_finite_and_not_negative(name, term, case):
    value = build(name).terms[term](*case)
    assert value.shape == (BATCH, TIMES)
    assert torch.isfinite(value).all()
    assert (value >= 0).all()


@every_term
def test_a_term_does_not_depend_on_where_north_is(name, term, case):
    motion, controls, problem = case
    turn, shift = torch.tensor(0.8).double(), torch.tensor([5.0, -3.0]).double()
    there, problem_there = moved(motion, problem, turn, shift)
    cost = build(name).terms[term]
    here = cost(motion, controls, problem)
    assert torch.allclose(cost(there, controls, problem_there), here, atol=1e-9)


@every_term
def test_the_value_at_a_time_depends_on_that_time_alone(name, term, case):
    motion, controls, problem = case
    cost = build(name).terms[term]

    def total(position, heading, velocity, yaw_rate, controls):
        return cost(Motion(position, heading, velocity, yaw_rate), controls, problem)

    jacobians = torch.autograd.functional.jacobian(total, (*motion, controls))
    for jacobian in jacobians:
        flat = jacobian.reshape(BATCH, TIMES, BATCH, TIMES, -1).abs().sum(-1)
        own = torch.eye(BATCH * TIMES).reshape(flat.shape).bool()
        assert (flat[~own] == 0).all()


@every_term
def test_gradients_are_exact_and_finite_at_rest_on_the_goal(name, term, case):
    motion, controls, problem = case
    cost = build(name).terms[term]

    def value(position, heading, velocity, yaw_rate, controls):
        return cost(Motion(position, heading, velocity, yaw_rate), controls, problem)

    inputs = [entry.requires_grad_() for entry in (*motion, controls)]
    assert torch.autograd.gradcheck(value, inputs, atol=1e-5, rtol=1e-4)
    still = [torch.zeros_like(entry).requires_grad_() for entry in inputs]
    still[0] = problem.goal.unsqueeze(1).expand(-1, TIMES, -1).clone().requires_grad_()
    gradients = torch.autograd.grad(value(*still).sum(), still, allow_unused=True)
    assert all(bool(each.isfinite().all()) for each in gradients if each is not None)


@every_term
def test_a_term_adds_up_components_exactly_if_it_says_so(name, term, case):
    motion, controls, problem = case
    agents = problem.obstacles
    alone = Obstacles(
        agents.position.flatten(1, 2).unsqueeze(2),
        agents.weight.flatten(1).unsqueeze(-1),
        agents.radius.repeat_interleave(2, 1),
        agents.valid.repeat_interleave(2, 1),
    )
    cost = build(name).terms[term]
    together = cost(motion, controls, problem)
    apart = cost(motion, controls, problem._replace(obstacles=alone))
    assert torch.allclose(apart, together, atol=1e-9) == cost.adds_components


@every_term
def test_who_is_not_valid_costs_nothing(name, term, case):
    motion, controls, problem = case
    cost = build(name).terms[term]
    gone = problem.obstacles._replace(valid=torch.zeros_like(problem.obstacles.valid))
    nobody = map_tensors(lambda entry: entry[:, :0], problem.obstacles)
    without = cost(motion, controls, problem._replace(obstacles=nobody))
    assert torch.equal(cost(motion, controls, problem._replace(obstacles=gone)), without)


@every_cost
def test_the_sum_is_that_of_its_reported_parts(name, case):
    cost = build(name)
    parts = cost.components(*case)
    assert torch.allclose(cost(*case), torch.stack(list(parts.values())).sum(0))
    assert set(parts) == set(cost.weights()) == set(cost.terms)


@every_cost
def test_driving_to_a_goal_ahead_is_cheaper_than_driving_away(name, case):
    _, controls, problem = case
    along = torch.linspace(0, 3, TIMES).double().expand(BATCH, TIMES)
    zero = torch.zeros_like(along)
    path = along.unsqueeze(-1) * direction(zero)
    forward = torch.stack([zero + 1, zero], -1)
    goal = torch.tensor([3.0, 0.0]).double().expand(BATCH, 2)
    nobody = map_tensors(lambda entry: entry[:, :0], problem.obstacles)
    there = problem._replace(goal=goal, reference=path, obstacles=nobody)
    ahead, away = (Motion(sign * path, zero, forward, zero) for sign in (1, -1))
    cost = build(name)
    idle = torch.zeros_like(controls)
    assert (cost(ahead, idle, there).sum(-1) < cost(away, idle, there).sum(-1)).all()
