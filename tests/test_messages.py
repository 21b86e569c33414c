"""Mistakes that users make, each told in one line that names what, where and the remedy."""

import dataclasses
import re

import numpy as np
import pytest
import torch

from diffstack_mmv.commands.data_checks import new_modes, other_history, require_same_horizon
from diffstack_mmv.control import ILQR, Bounds
from diffstack_mmv.dynamics import DiffGM3, DiffKBM, ExtendedUnicycle, rollout
from diffstack_mmv.dynamics.manoeuvres import RecordedControls
from diffstack_mmv.vehicles import load_vehicle

BICYCLE = load_vehicle("bicycle")
MODEL = DiffKBM(BICYCLE)
STATE, CONTROLS = torch.zeros(1, 4), torch.zeros(1, 5, 2)


def energy(states, controls):
    return states.square().sum(-1) + controls.square().sum(-1)


def solve(dynamics=MODEL, cost=energy, bounds=MODEL.bounds, state=STATE, controls=CONTROLS):
    return ILQR(max_iterations=1)(dynamics, cost, bounds, state, controls)


@pytest.fixture(autouse=True)
def _unchecked(unchecked):
    """As users run it, without the checks of the tests."""


@pytest.mark.parametrize(
    ("mistake", "error", "told"),
    [
        ({"controls": torch.zeros(1, 2)}, ValueError, "`controls` must have one dimension more"),
        ({"controls": torch.zeros(2, 5, 2)}, ValueError, "`controls` must have the leading"),
        ({"controls": torch.zeros(1, 5, 3)}, ValueError, "`bounds.lower` must have shape (3,)"),
        ({"controls": torch.zeros(1, 0, 2)}, ValueError, "`controls` must cover at least one"),
        ({"controls": CONTROLS.double()}, ValueError, "`controls` must be torch.float32 as the"),
        ({"state": STATE.long()}, TypeError, "`state` must be torch.float32 or torch.float64, but"),
        ({"state": STATE.half()}, TypeError, "`state` must be torch.float32 or torch.float64, but"),
        ({"state": np.zeros((1, 4))}, TypeError, "`state` must be a tensor, but got ndarray"),
        ({"state": torch.zeros(1, 3)}, ValueError, "`state` must have 4 columns (position_x,"),
        ({"bounds": (-1.0, 1.0)}, TypeError, "`bounds` must be Bounds, but got tuple"),
        ({"bounds": Bounds(*reversed(MODEL.bounds))}, ValueError, "`bounds` must be in order"),
        ({"cost": lambda x, u: x.sum()}, ValueError, "`cost` must return the shape (1, 6), but"),
        ({"cost": lambda x, u: x}, ValueError, "`cost` must return the shape (1, 6), but got (1,"),
        ({"cost": lambda x, u: None}, TypeError, "`cost(states, controls)` must be a tensor, but"),
        ({"dynamics": lambda x, u: x[..., :3]}, ValueError, "`dynamics` must return the shape (1"),
    ],
)
def test_problems_of_the_solver_that_do_not_fit(mistake, error, told):
    with pytest.raises(error, match=re.escape(told)):
        solve(**mistake)


@pytest.mark.parametrize(
    ("act", "error", "told"),
    [
        (lambda: MODEL(torch.zeros(1, 3), torch.zeros(1, 2)), ValueError, "`state` must have 4"),
        (lambda: MODEL(STATE, torch.zeros(1, 3)), ValueError, "`control` must have 2 columns (acc"),
        (lambda: MODEL([0.0] * 4, [0.0] * 2), TypeError, "`state` must be a tensor, but got list"),
        (lambda: rollout(MODEL, STATE, torch.zeros(2)), ValueError, "`controls` must have the sh"),
        (lambda: rollout(MODEL, STATE, torch.zeros(3, 5, 2)), ValueError, "shape (1, T, m) to fit"),
        (lambda: DiffKBM(BICYCLE, dt_s=0.0), ValueError, "`dt_s` must be positive, but got 0"),
        (lambda: load_vehicle("bike"), ValueError, "`vehicle` must be one of autobike, bicycle"),
    ],
)
def test_arguments_of_models_that_do_not_fit(act, error, told):
    with pytest.raises(error, match=re.escape(told)):
        act()


@pytest.mark.parametrize("model", [DiffKBM, DiffGM3, ExtendedUnicycle])
def test_a_name_in_the_place_of_a_vehicle(model):
    told = r"`spec` must be a VehicleSpec, but got str 'bicycle'. Give load_vehicle\(NAME_OR_PATH"
    with pytest.raises(TypeError, match=told):
        model("bicycle")


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
@pytest.mark.parametrize("model", [DiffKBM, DiffGM3, ExtendedUnicycle])
def test_a_model_in_half_precision(model, dtype):
    built = model(BICYCLE)
    told = f"`dtype` must be torch.float32 or torch.float64, but got {dtype} for {model.__name__}."
    with pytest.raises(TypeError, match=re.escape(told)):
        torch.nn.Sequential(built).to(dtype)
    assert {buffer.dtype for buffer in built.buffers()} <= {torch.float32, torch.int64}


def test_wheelbases_in_other_units():
    wheelbase = dataclasses.replace(BICYCLE.wheelbase, unit="mm")
    told = "`wheelbase.unit` must be 'm', but got 'mm' for vehicle 'bicycle'"
    with pytest.raises(ValueError, match=told):
        dataclasses.replace(BICYCLE, wheelbase=wheelbase)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("acceleration_mps2,steer_rad\n0,45\n", "stay below π/2 in the column steer_rad, but got"),
        ("acceleration_mps2,steer_deg\n0,45\n", "with the columns acceleration_mps2, steer_rad"),
        ("acceleration,steer\n0,1\n", "steer_rad, but got the columns acceleration, steer in"),
        ("acceleration_mps2;steer_rad\n0;1\n", "Name them in the first row, between commas."),
        ("acceleration_mps2,steer_rad\n0,1\n0,x\n", "'x' in row 2, column steer_rad, in"),
        ("acceleration_mps2,steer_rad\n0\n", "but got None in row 1, column steer_rad, in"),
        ("acceleration_mps2,steer_rad\n0,nan\n", "but got [0.0, nan] in row 1 in"),
        ("acceleration_mps2,steer_rad\n0,1,2\n", "but got more in row 1 in"),
        ("", "but got an empty file in"),
        (
            "time_s,acceleration_mps2,steer_rad\n0,0,0\n0.1,0,0\n0.6,0,0\n",
            "have steps of 0.1 s in the column time_s, but got 0.5 s before row 3 in",
        ),
        ("acceleration_mps2,steer_rad\n", "`controls` must hold at least one row, but got 0 in"),
    ],
)
def test_recorded_controls_of_other_units_or_columns(content, told, tmp_path):
    file = tmp_path / "controls.csv"
    file.write_text(content)
    with pytest.raises(ValueError, match=re.escape(told)):
        RecordedControls(file)(1.0, 0.1)


@pytest.mark.parametrize("name", ["horizon_s", "dt_s"])
def test_another_horizon_than_that_of_the_checkpoint(name):
    trained = {"horizon_s": 3.0, "dt_s": 0.1}
    require_same_horizon(trained, trained)
    told = f"`{name}` must be {trained[name]} as in the training, but got 9.0 for this checkpoint"
    with pytest.raises(ValueError, match=re.escape(told)):
        require_same_horizon(trained | {name: 9.0}, trained)


def test_another_past_than_that_of_the_checkpoint_is_told():
    assert other_history({"history_s": 2.0}, {"history_s": 2.0}) is None
    told = other_history({"history_s": 4.0}, {"history_s": 2.0})
    assert told is not None
    assert "Give history_s=2" in told


@pytest.mark.parametrize(
    ("modes", "epochs", "told"),
    [
        (["bicycle"], 2, None),
        (["Bicycle", "scooter"], 2, None),
        (["pedestrian", "bicycle"], 0, None),
        (
            ["pedestrian", "bicycle"],
            2,
            "Egos of mode pedestrian are judged, but the checkpoint was",
        ),
    ],
)
def test_modes_that_the_training_had_none_of_are_told(modes, epochs, told):
    found = new_modes(modes, {"modes": ["scooter", "bicycle"], "epochs": epochs})
    assert (found or "").startswith(told or "")
    assert (found is None) == (told is None)
