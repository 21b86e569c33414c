"""Multiple shooting: what it has in common with single shooting, and what it does better."""

import pytest
import torch

from diffstack_mmv.dynamics.manoeuvres import Turn
from diffstack_mmv.identification import (
    Identifier,
    LevenbergMarquardt,
    MultipleShooting,
    infer_controls,
)
from diffstack_mmv.identification.shooting.fit import total_cost
from diffstack_mmv.identification.shooting.tracking import infer_controls_with_gaps
from tests.identification.conftest import LIVELY, double_precision, synthetic_problem

LONG_TURN = (Turn(7.0, -0.9, 10.0, 0.5, 2.5),)


def begun(setup):
    simulator, problem = setup.simulator, setup.data.fitted
    return simulator, simulator.parameters.start(), problem


def fitted(setup, method=None):
    return Identifier(method or MultipleShooting(), starts=0)(setup.simulator, setup.data).after


@pytest.fixture(scope="module")
def single_shooting():
    """Optimum without cuts, and its cost."""
    with double_precision():
        whole = synthetic_problem("kbm", {"wheelbase": 1.15}, segment_steps=None)
        found = fitted(whole)
        return found.theta, total_cost(whole.simulator, found)


@pytest.mark.parametrize("steps", [1, 4, pytest.param(1000, marks=pytest.mark.slow)])
def test_every_cut_has_the_optimum_of_single_shooting(single_shooting, steps):
    cut = synthetic_problem("kbm", {"wheelbase": 1.15}, segment_steps=steps)
    found = fitted(cut)
    torch.testing.assert_close(found.theta, single_shooting[0], rtol=1e-4, atol=1e-5)
    assert total_cost(cut.simulator, found) == pytest.approx(single_shooting[1], rel=1e-6)


def test_one_segment_has_no_node_and_no_gap():
    setup = synthetic_problem("kbm", {}, segment_steps=1000)
    simulator, theta, problem = begun(setup)
    now = simulator.simulate(theta, problem, problem.guess)
    assert problem.guess.nodes.shape[1] == now.gap.shape[1] == 0


@pytest.mark.parametrize("dynamics", ["unicycle", "kbm", "gm3"])
def test_segments_meet_at_the_solution(dynamics):
    setup = synthetic_problem(dynamics, {}, dynamics != "unicycle", LIVELY[:2])
    simulator, theta, problem = begun(setup)
    begin = simulator.simulate(theta, problem, problem.guess).gap.abs().max()
    found = infer_controls_with_gaps(simulator, theta, problem, problem.guess)
    assert float(begin) > 0.01
    assert float(found.simulated.gap.abs().max()) < 1e-4
    whole = simulator.simulate_continuous(theta, problem, found.unknowns).simulated
    torch.testing.assert_close(whole.cost, found.simulated.cost, rtol=1e-4, atol=0.0)


def test_solution_in_one_piece_is_stationary():
    setup = synthetic_problem("kbm", {})
    simulator, theta, problem = begun(setup)
    found = infer_controls(simulator, theta, problem, problem.guess, LevenbergMarquardt(30, 1e-12))
    rates = found.unknowns.rates.requires_grad_()
    whole = found.unknowns._replace(rates=rates, nodes=found.unknowns.nodes[:, :0])
    simulator.simulate(theta, problem, whole).cost.sum().backward()
    assert float(rates.grad.abs().max()) < 1e-4


def test_guess_without_the_recorded_rates_does_little_harm():
    """Nodes lie on the track, however wrong the rates are; one segment leaves it by far."""
    costs = {}
    for steps in (5, None):
        setup = synthetic_problem("kbm", {}, segment_steps=steps)
        simulator, theta, problem = begun(setup)
        blind = problem.guess._replace(rates=torch.zeros_like(problem.guess.rates))
        costs[steps] = infer_controls(
            simulator, theta, problem, blind, LevenbergMarquardt(2)
        ).simulated.cost
    assert bool((costs[5] <= costs[None] + 1e-6).all())
    assert float(costs[5].sum()) < 0.2 * float(costs[None].sum())


@pytest.fixture(scope="module")
def optimum():
    """A problem and its fit."""
    with double_precision():
        setup = synthetic_problem("kbm", {"wheelbase": 1.15})
        return setup, fitted(setup)


def test_refit_from_the_optimum_stays_there(optimum):
    setup, one = optimum
    active = torch.ones_like(one.theta, dtype=torch.bool)
    two = MultipleShooting(restart=False)(setup.simulator, setup.data, one, active)
    torch.testing.assert_close(two.theta, one.theta, rtol=1e-4, atol=1e-4)
    assert len(two.history) <= 3


def test_what_ends_above_the_cost_before_is_fitted_from_there(optimum):
    setup, one = optimum
    active = torch.ones_like(one.theta, dtype=torch.bool)
    # one iteration from the recorded track cannot reach the optimum
    two = MultipleShooting(max_iterations=1)(setup.simulator, setup.data, one, active)
    assert total_cost(setup.simulator, two) <= total_cost(setup.simulator, one) + 1e-9


@pytest.mark.slow
def test_long_turn_at_the_limit_is_solved_where_single_shooting_is_not():
    found = {}
    for steps in (5, None):
        setup = synthetic_problem("gm3", {}, False, LONG_TURN, segment_steps=steps)
        simulator, theta, problem = begun(setup)
        found[steps] = infer_controls(
            simulator, theta, problem, problem.guess, LevenbergMarquardt(15)
        )
    assert bool(found[5].converged.all())
    assert not bool(found[None].converged.any())
    assert float(found[5].simulated.cost) < float(found[None].simulated.cost)
