"""Parameters and controls together, by two ways that share only the problem."""

import logging

import pytest

from diffstack_mmv.control import ILQR
from diffstack_mmv.identification import (
    BilevelFit,
    HeldoutStopping,
    Identifiability,
    Identifier,
    MultipleShooting,
)
from tests.identification.conftest import LAZY, LIVELY, double_precision, synthetic_problem

PATIENT = HeldoutStopping(patience=100)


def identified(setup, method=None):
    return Identifier(method or MultipleShooting(), starts=0)(setup.simulator, setup.data)


def estimate(setup, found):
    return setup.simulator.parameters.values(found.after.theta)


@pytest.fixture(scope="module")
def recovered():
    """A bicycle 10 cm longer than its prior, whose controls were measured, and what is found."""
    with double_precision():
        setup = synthetic_problem("kbm", {"wheelbase": 1.15})
        return setup, identified(setup)


def test_wheelbase_is_recovered_when_controls_were_measured(recovered):
    setup, found = recovered
    assert found.identifiability == (Identifiability.IDENTIFIABLE,)
    assert float(estimate(setup, found)) == pytest.approx(1.15, rel=0.05)
    assert abs(float(estimate(setup, found)) - 1.15) < 3 * float(found.sensitivity.std)
    assert 0.8 < found.noise_factor < 1.2


def test_same_input_gives_the_same_estimate_and_progress_is_logged(recovered, caplog):
    setup = synthetic_problem("kbm", {"wheelbase": 1.15})
    with caplog.at_level(logging.INFO):
        found = identified(setup)
    assert float(estimate(setup, found)) == float(estimate(*recovered))
    assert any("Iteration 1: cost" in record.message for record in caplog.records)


def test_differentiable_mpc_and_shooting_find_the_same_wheelbase():
    setup = synthetic_problem("kbm", {"wheelbase": 0.95}, manoeuvres=LIVELY[2:])
    one = identified(setup, MultipleShooting(stopping=PATIENT))
    two = identified(setup, BilevelFit(stopping=PATIENT, solver=ILQR(max_iterations=30)))
    apart = (estimate(setup, one) - estimate(setup, two)).abs() / one.sensitivity.std
    assert float(apart) < 0.05


@pytest.mark.parametrize(
    ("known", "manoeuvres"), [(False, LIVELY), (True, LAZY)], ids=["free steering", "lazy rides"]
)
def test_uninformed_wheelbase_is_flagged_and_stays_at_its_prior(known, manoeuvres):
    setup = synthetic_problem("kbm", {"wheelbase": 1.15}, known, manoeuvres)
    found = identified(setup)
    assert found.identifiability == (Identifiability.NOT_IDENTIFIABLE,)
    assert float(estimate(setup, found)) == pytest.approx(1.05, abs=1e-12)
    assert float(found.sensitivity.std) == pytest.approx(0.07875, rel=0.05)


def test_fit_explains_held_out_tracks_better_than_the_prior():
    setup = synthetic_problem("kbm", {"wheelbase": 1.2}, manoeuvres=LIVELY[1:])
    found = identified(setup)
    costs = [float(fit.heldout.simulated.cost.sum()) for fit in (found.before, found.after)]
    assert costs[1] < costs[0]


@pytest.mark.slow
def test_differentiable_mpc_and_shooting_agree_on_tyres():
    truth = {"tread_stiffness.front": 1.4e6}
    setup = synthetic_problem("gm3", truth, True, LIVELY[2:], parameters=["tread_stiffness"])
    one = identified(setup, MultipleShooting(stopping=PATIENT))
    two = identified(setup, BilevelFit(stopping=PATIENT))
    apart = (estimate(setup, one) - estimate(setup, two)).abs() / one.sensitivity.std
    assert bool((apart < 0.1).all())


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say():
    covered, errors = [], []
    for seed in range(20):
        truth = 0.9 + 0.3 * (seed + 0.5) / 20
        setup = synthetic_problem("kbm", {"wheelbase": truth}, seed=seed)
        found = identified(setup)
        error = abs(float(estimate(setup, found)) - truth)
        covered.append(error <= 2 * float(found.sensitivity.std))
        errors.append(error / truth)
        assert found.identifiability == (Identifiability.IDENTIFIABLE,)
    assert sum(covered) >= 17
    assert max(errors) < 0.05
