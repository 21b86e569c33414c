"""Controls that explain a track."""

import pytest
import torch

from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.identification import (
    ParameterVector,
    TrackingModel,
    TrackingSettings,
    TrackSimulator,
    infer_controls,
    stack_segments,
)
from diffstack_mmv.identification.shooting.normal_equations import stack_unknowns, unstack_unknowns
from diffstack_mmv.identification.shooting.tracking import tracking_rmse
from tests.identification.conftest import LAZY, LIVELY, synthetic_problem


def tracked(setup):
    simulator, problem = setup.simulator, setup.data.fitted
    return infer_controls(simulator, simulator.parameters.start(), problem, problem.guess)


@pytest.mark.parametrize("dynamics", ["unicycle", "kbm", "gm3"])
def test_every_model_follows_its_own_tracks_within_the_noise(dynamics):
    setup = synthetic_problem(dynamics, {}, False, LIVELY[:2])
    found = tracked(setup)
    rmse = tracking_rmse(setup.simulator, found.simulated.states, setup.data.fitted.measurements)
    assert bool(found.converged.all())
    assert bool((rmse < 0.03).all())


def test_stationary_at_the_solution():
    setup = synthetic_problem("kbm", {})
    found = tracked(setup)
    vector = stack_unknowns(found.unknowns).requires_grad_()
    theta = setup.simulator.parameters.start()
    setup.simulator.simulate(
        theta, setup.data.fitted, unstack_unknowns(vector, found.unknowns.nodes[:, :0])
    ).cost.sum().backward()
    assert float(vector.grad.abs().max()) < 0.2


def test_padding_and_batch_mates_change_nothing():
    setup = synthetic_problem("kbm", {}, known=False)
    together = tracked(setup)
    for index, segment in enumerate(setup.split.fitted):
        problem = setup.simulator.vehicle.problem(stack_segments([segment]))
        alone = infer_controls(
            setup.simulator, setup.simulator.parameters.start(), problem, problem.guess
        )
        steps = alone.unknowns.rates.shape[1]
        torch.testing.assert_close(
            together.unknowns.rates[index, :steps], alone.unknowns.rates[0], atol=5e-3, rtol=0.0
        )


def test_wheelbase_does_not_matter_while_steering_is_free(bicycle):
    setup = synthetic_problem("kbm", {}, known=False)
    theta = torch.tensor([0.8])
    problem = setup.data.fitted
    moved = infer_controls(setup.simulator, theta, problem, problem.guess)
    torch.testing.assert_close(
        moved.simulated.cost, tracked(setup).simulated.cost, rtol=1e-4, atol=0.0
    )


def test_noise_of_controls_that_nobody_recorded_is_refused(bicycle):
    setup = synthetic_problem("kbm", {}, known=False)
    model = model_of(bicycle, "kbm", 0.1).double()
    vehicle = TrackingModel(model, TrackingSettings(control_noise=(0.1, 0.01))).double()
    TrackSimulator(vehicle, ParameterVector(model, bicycle))
    with pytest.raises(ValueError, match="`control_noise` must be null.*no controls"):
        vehicle.problem(stack_segments(setup.split.fitted))


@pytest.mark.parametrize("name", ["along_m", "jerk_mps3", "steer_rate_radps"])
def test_settings_that_are_not_positive_are_refused(name):
    with pytest.raises(ValueError, match=f"`{name}` must be positive"):
        TrackingSettings(**{name: 0.0})


def test_tracks_without_a_finite_start_are_refused():
    setup = synthetic_problem("kbm", {}, manoeuvres=LAZY)
    problem = setup.data.fitted
    broken = problem._replace(start=problem.start * torch.nan)
    with pytest.raises(ValueError, match="`tracks` must give a finite cost"):
        infer_controls(setup.simulator, setup.simulator.parameters.start(), broken, problem.guess)
