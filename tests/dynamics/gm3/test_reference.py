"""The whole right-hand side and whole trajectories against the reference."""

import numpy as np
import pytest
import torch

from diffstack_mmv.dynamics import rollout
from diffstack_mmv.dynamics.gm3 import (
    LIM2,
    ConsistentBrush,
    DiffGM3,
    PaperBrush,
    RungeKutta4,
)
from tests.dynamics.gm3.conftest import VEHICLES

LAWS = {"": ConsistentBrush(), "_paper": PaperBrush(100.0, 1e-8)}


@pytest.mark.parametrize(("dtype", "limit"), [(torch.float64, 1e-9), (torch.float32, 2e-5)])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("vehicle", VEHICLES)
def test_right_hand_side_matches_the_reference(vehicle, law, dtype, limit, reference, sides):
    model = reference.model(vehicle, tire=LAWS[law]).to(dtype)
    found = model.derivative(sides[f"{vehicle}_x"].to(dtype), sides[f"{vehicle}_u"].to(dtype))
    expected = sides[f"{vehicle}_xdot{law}"]
    error = (found.double() - expected).abs() / expected.abs().amax(-1, keepdim=True).clamp_min(
        1e-6
    )
    assert error.max() < limit


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_wheel_forces_match_the_reference(vehicle, reference, sides):
    model = reference.model(vehicle)
    found = model.wheel_forces(sides[f"{vehicle}_x"], sides[f"{vehicle}_u"])
    named = {"force_x": "Fx", "force_y": "Fy", "moment_z": "Mz", "normal_load": "Fz"}
    for ours, theirs in named.items():
        expected = sides[f"{vehicle}_{theirs}"]
        scale = expected.abs().amax(-1, keepdim=True).clamp_min(1e-6)
        assert ((getattr(found, ours) - expected).abs() < 1e-9 * scale).all(), ours


def position_errors(reference, vehicle, law="", kinds=("normal", "stopgo"), **settings):
    """Largest position error in m of every regular sequence, over 3 s and over 5 s."""
    stored = reference.load(f"traj_{vehicle}")
    spec = reference.spec(vehicle.split("_")[0], stored.get("brake"))
    model = DiffGM3(spec, tire=LAWS[law], **settings).double().requires_grad_(False)
    states = rollout(model, torch.as_tensor(stored["x0"]), torch.as_tensor(stored["u"]))
    apart = np.linalg.norm(states.numpy()[..., :2] - stored[f"x{law}"][..., :2], axis=-1)
    apart = apart[stored["regular"] & np.isin(stored["kind"], kinds)]
    return apart[:, :31].max(1), apart.max(1)


@pytest.fixture(scope="module")
def one_step(reference):
    pooled = [position_errors(reference, vehicle) for vehicle in VEHICLES]
    return tuple(np.concatenate(errors) for errors in zip(*pooled, strict=True))


def test_one_step_per_interval_is_accurate_on_all_vehicles(one_step):
    short, long = one_step
    assert np.median(short) < 0.01
    assert np.percentile(short, 95) < 0.04
    assert short.max() < 0.06
    assert long.max() < 0.15


def test_printed_law_is_stepped_as_accurately(reference):
    pooled = [position_errors(reference, vehicle, "_paper")[0] for vehicle in VEHICLES]
    assert np.percentile(np.concatenate(pooled), 95) < 0.04


@pytest.mark.parametrize("vehicle", ["bicycle_rearbrake", "scooter_rearbrake"])
def test_braking_by_the_rear_wheel_alone_is_accurate(vehicle, reference):
    short, _ = position_errors(reference, vehicle, kinds=("normal", "stopgo", "brisk"))
    assert short.max() < 0.1


@pytest.mark.slow
def test_error_falls_with_substeps(reference, one_step):
    def errors(vehicle, steps):
        return position_errors(reference, vehicle, substeps=steps)[0]

    pooled = {
        steps: np.concatenate([errors(vehicle, steps) for vehicle in VEHICLES]) for steps in (2, 4)
    }
    assert np.percentile(pooled[2], 95) < 0.06
    for measure in (np.median, lambda found: np.percentile(found, 95)):
        assert measure(pooled[4]) < measure(one_step[0]) / 5
    for vehicle in VEHICLES:
        # steps of 25 ms do not resolve the fastest rates of a skateboard, those of 12 ms do
        coarse, fine = (2, 8) if vehicle == "skateboard" else (1, 4)
        assert errors(vehicle, fine).max() < errors(vehicle, coarse).max() / 3, vehicle


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("vehicle", VEHICLES)
def test_small_steps_reproduce_the_reference_trajectories(vehicle, law, reference):
    kinds = ("normal", "stopgo", "brisk")
    _, long = position_errors(reference, vehicle, law, kinds, substeps=100, stepper=RungeKutta4())
    assert long.max() < 1e-4


def gradient(reference, vehicle, substeps):
    """∂p_T/∂u over 30 steps of every regular sequence, flattened."""
    stored = reference.load(f"traj_{vehicle}")
    model = reference.model(vehicle, substeps=substeps, stepper=LIM2())
    controls = torch.as_tensor(stored["u"])[:, :30].clone().requires_grad_()
    end = rollout(model, torch.as_tensor(stored["x0"]), controls)[:, -1]
    parts = [
        torch.autograd.grad(end[:, column].sum(), controls, retain_graph=True)[0]
        for column in (0, 1)
    ]
    return torch.stack(parts, 1).flatten(1)[torch.as_tensor(stored["regular"])]


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", VEHICLES)
def test_gradient_over_three_seconds_is_that_of_the_converged_motion(vehicle, reference):
    found, converged = gradient(reference, vehicle, 1), gradient(reference, vehicle, 16)
    ratio = found.norm(dim=1) / converged.norm(dim=1)
    cosine = torch.nn.functional.cosine_similarity(found, converged, dim=1)
    assert ratio.max() < 1.2
    assert cosine.quantile(0.1) > 0.98
    assert cosine.min() > 0.9
