"""Controls that explain a track."""

import pytest
import torch

from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.identification import (
    LearnedParameters,
    TrackedVehicle,
    Tracker,
    TrackingSettings,
    batch,
    track,
)
from diffstack_mmv.identification.linearisation import flat, unflat
from diffstack_mmv.identification.tracking import tracking_rmse
from tests.identification.conftest import LIVELY, synthetic_case


def tracked(case):
    tracker, problem = case.tracker, case.data.fitted
    return track(tracker, tracker.parameters.start(), problem, problem.guess)


@pytest.mark.parametrize("dynamics", ["unicycle", "kbm", "gm3"])
def test_every_model_follows_its_own_tracks_within_the_noise(dynamics):
    case = synthetic_case(dynamics, {}, False, LIVELY[:2])
    found = tracked(case)
    rmse = tracking_rmse(case.tracker, found.simulated.states, case.data.fitted.targets)
    assert bool(found.converged.all())
    assert bool((rmse < 0.03).all())


def test_stationary_at_the_solution():
    case = synthetic_case("kbm", {})
    found = tracked(case)
    vector = flat(found.unknowns).requires_grad_()
    theta = case.tracker.parameters.start()
    case.tracker.simulate(
        theta, case.data.fitted, unflat(vector, found.unknowns.nodes[:, :0])
    ).cost.sum().backward()
    assert float(vector.grad.abs().max()) < 0.2


def test_padding_and_batch_mates_change_nothing():
    case = synthetic_case("kbm", {}, known=False)
    together = tracked(case)
    for index, stretch in enumerate(case.division.fitted):
        problem = case.tracker.vehicle.problem(batch([stretch]))
        alone = track(case.tracker, case.tracker.parameters.start(), problem, problem.guess)
        steps = alone.unknowns.rates.shape[1]
        torch.testing.assert_close(
            together.unknowns.rates[index, :steps], alone.unknowns.rates[0], atol=5e-3, rtol=0.0
        )


def test_wheelbase_does_not_matter_while_steering_is_free(bicycle):
    case = synthetic_case("kbm", {}, known=False)
    theta = torch.tensor([0.8])
    problem = case.data.fitted
    moved = track(case.tracker, theta, problem, problem.guess)
    torch.testing.assert_close(
        moved.simulated.cost, tracked(case).simulated.cost, rtol=1e-4, atol=0.0
    )


def test_noise_of_controls_that_nobody_recorded_is_refused(bicycle):
    case = synthetic_case("kbm", {}, known=False)
    model = model_of(bicycle, "kbm", 0.1).double()
    vehicle = TrackedVehicle(model, TrackingSettings(control_noise=(0.1, 0.01))).double()
    Tracker(vehicle, LearnedParameters(model, bicycle))
    with pytest.raises(ValueError, match="`control_noise` must be null.*no controls"):
        vehicle.problem(batch(case.division.fitted))


@pytest.mark.parametrize("name", ["along_m", "jerk_mps3", "steer_rate_radps"])
def test_settings_that_are_not_positive_are_refused(name):
    with pytest.raises(ValueError, match=f"`{name}` must be positive"):
        TrackingSettings(**{name: 0.0})
