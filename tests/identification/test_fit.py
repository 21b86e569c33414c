"""Parameters and controls together, by two ways that share only the problem."""

import logging
from dataclasses import replace

import pytest
import torch

from diffstack_mmv.control import ILQR
from diffstack_mmv.dynamics import DiffKBM
from diffstack_mmv.identification import (
    Case,
    EarlyStopping,
    Fit,
    Identifier,
    Nested,
    Shooting,
    TrackingSettings,
    Verdict,
    track,
)
from diffstack_mmv.identification.fit import Watch
from diffstack_mmv.identification.tracking import Tracked
from tests.identification.conftest import LAZY, LIVELY, synthetic_case

PATIENT = EarlyStopping(patience=100)


def identified(case, method=None):
    return Identifier(method or Shooting(), starts=0)(case.tracker, case.data)


def estimate(case, found):
    return case.tracker.parameters.values(found.after.theta)


def test_wheelbase_is_recovered_when_controls_were_measured():
    case = synthetic_case("kbm", {"wheelbase": 1.15})
    found = identified(case)
    assert found.verdicts == (Verdict.IDENTIFIABLE,)
    assert float(estimate(case, found)) == pytest.approx(1.15, rel=0.05)
    assert abs(float(estimate(case, found)) - 1.15) < 3 * float(found.sensitivity.std)
    assert 0.8 < found.noise_factor < 1.2


def test_differentiable_mpc_and_shooting_find_the_same_wheelbase():
    case = synthetic_case("kbm", {"wheelbase": 0.95}, manoeuvres=LIVELY[2:])
    one = identified(case, Shooting(stopping=PATIENT))
    two = identified(case, Nested(stopping=PATIENT, solver=ILQR(max_iterations=30)))
    apart = (estimate(case, one) - estimate(case, two)).abs() / one.sensitivity.std
    assert float(apart) < 0.05


@pytest.mark.parametrize(
    ("known", "manoeuvres"), [(False, LIVELY), (True, LAZY)], ids=["free steering", "lazy rides"]
)
def test_uninformed_wheelbase_is_flagged_and_stays_at_its_prior(known, manoeuvres):
    case = synthetic_case("kbm", {"wheelbase": 1.15}, known, manoeuvres)
    found = identified(case)
    assert found.verdicts == (Verdict.NOT_IDENTIFIABLE,)
    assert float(estimate(case, found)) == pytest.approx(1.05, abs=1e-12)
    assert float(found.sensitivity.std) == pytest.approx(0.07875, rel=0.05)


def test_fit_explains_held_out_tracks_better_than_the_prior():
    case = synthetic_case("kbm", {"wheelbase": 1.2}, manoeuvres=LIVELY[1:])
    found = identified(case)
    costs = [float(fit.heldout.simulated.cost.sum()) for fit in (found.before, found.after)]
    assert costs[1] < costs[0]


def test_same_input_gives_the_same_estimate():
    estimates = []
    for _ in range(2):
        case = synthetic_case("kbm", {"wheelbase": 1.15})
        estimates.append(float(estimate(case, identified(case))))
    assert estimates[0] == estimates[1]


@pytest.fixture(scope="module")
def blank():
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    case = synthetic_case("kbm", {}, manoeuvres=LAZY[:1])
    problem, theta = case.data.heldout, case.tracker.parameters.start()
    simulated = case.tracker.simulate(theta, problem, problem.guess)
    tracked = Tracked(problem.guess, simulated, torch.ones(1, dtype=torch.bool))
    torch.set_default_dtype(before)
    return Fit(theta, tracked, tracked, ())


def with_costs(blank, costs):
    simulated = blank.heldout.simulated._replace(cost=torch.tensor(costs))
    return blank._replace(heldout=blank.heldout._replace(simulated=simulated))


def test_fit_ends_at_the_last_iterate_before_all_held_out_tracks_get_worse(blank):
    fits = [with_costs(blank, [cost] * 9) for cost in (3.0, 2.0, 2.5, 2.6, 2.7)]
    watch = Watch(EarlyStopping(patience=3), fits[0])
    goes_on = [watch.see(fit, 0.0) for fit in fits]
    assert goes_on == [True, True, True, True, False]
    assert watch.best is fits[1]


def test_held_out_tracks_that_disagree_stop_nothing(blank):
    fits = [with_costs(blank, costs) for costs in ([3.0, 3.0, 3.0], [2.0, 3.5, 4.5])]
    watch = Watch(EarlyStopping(patience=1), fits[0])
    assert all(watch.see(fit, 0.0) for fit in fits)
    assert watch.best is fits[1]


def test_progress_is_logged(caplog):
    with caplog.at_level(logging.INFO):
        identified(synthetic_case("kbm", {"wheelbase": 1.15}))
    assert any("Iteration 1: cost" in record.message for record in caplog.records)


def test_chosen_parameters_alone_move():
    case = synthetic_case("gm3", {}, manoeuvres=LAZY, parameters=["yaw_damping"])
    assert case.tracker.parameters.names == ["yaw_damping"]


def test_vehicle_with_nothing_to_learn_is_refused(bicycle):
    case = synthetic_case("kbm", {}, manoeuvres=LAZY, known=False)
    spec = replace(bicycle, wheelbase=replace(bicycle.wheelbase, learn=False))
    with pytest.raises(ValueError, match="`vehicle` must have parameters marked `learn: true`"):
        Case.of(DiffKBM(spec), spec, case.division, TrackingSettings())


@pytest.mark.slow
def test_differentiable_mpc_and_shooting_agree_on_tyres():
    truth = {"tread_stiffness.front": 1.4e6}
    case = synthetic_case("gm3", truth, True, LIVELY[2:], parameters=["tread_stiffness"])
    one = identified(case, Shooting(stopping=PATIENT))
    two = identified(case, Nested(stopping=PATIENT))
    apart = (estimate(case, one) - estimate(case, two)).abs() / one.sensitivity.std
    assert bool((apart < 0.1).all())


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say():
    covered, errors = [], []
    for seed in range(20):
        truth = 0.9 + 0.3 * (seed + 0.5) / 20
        case = synthetic_case("kbm", {"wheelbase": truth}, seed=seed)
        found = identified(case)
        error = abs(float(estimate(case, found)) - truth)
        covered.append(error <= 2 * float(found.sensitivity.std))
        errors.append(error / truth)
        assert found.verdicts == (Verdict.IDENTIFIABLE,)
    assert sum(covered) >= 17
    assert max(errors) < 0.05


def test_tracks_without_a_finite_start_are_refused():
    case = synthetic_case("kbm", {}, manoeuvres=LAZY)
    problem = case.data.fitted
    broken = problem._replace(start=problem.start * torch.nan)
    with pytest.raises(ValueError, match="`tracks` must give a finite cost"):
        track(case.tracker, case.tracker.parameters.start(), broken, problem.guess)
