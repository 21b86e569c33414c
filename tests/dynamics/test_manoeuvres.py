"""Scripted manoeuvres, recorded controls and open-loop runs."""

import math

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3, DiffKBM, ExtendedUnicycle
from diffstack_mmv.dynamics.lagged_truth import VARIANTS, LaggedTruth, command_profiles, score
from diffstack_mmv.dynamics.manoeuvres import Braking, RecordedControls, Slalom, Turn
from diffstack_mmv.dynamics.open_loop import drive, save_run, wheel_history
from diffstack_mmv.vehicles import load_vehicle

SPEC = load_vehicle("bicycle")


def run(model, manoeuvre):
    model = model(SPEC).double()
    return drive(model, manoeuvre(1.05, 0.1), manoeuvre.speed_mps)


@pytest.mark.parametrize(
    ("manoeuvre", "heading", "off"),
    [
        (Turn(4.0, math.pi / 2, 6.0), math.pi / 2, 0.1),
        (Turn(4.0, -math.pi, 6.0), -math.pi, 0.1),
        (Turn(4.0, -0.1, 6.0), -0.1, 0.01),
        (Turn(15.0, math.pi / 4, 8.0), math.pi / 4, 0.02),
        (Turn(4.0, 0.0, 6.0), 0.0, 0.0),
        (Slalom(4.0, 0.1, 6.0, 3), 0.0, 0.05),
    ],
    ids=["left", "back by the right", "slightly", "within the ramps", "not at all", "slalom"],
)
def test_a_manoeuvre_ends_at_its_heading(manoeuvre, heading, off):
    motion = run(ExtendedUnicycle, manoeuvre).motion
    assert motion.heading[-1].item() == pytest.approx(heading, abs=off)


@pytest.mark.parametrize("model", [DiffGM3, DiffKBM, ExtendedUnicycle])
def test_models_agree_on_gentle_commands(model):
    gentle = Slalom(3.0, 0.02, 6.0)
    paths = [run(each, gentle).motion.position for each in (model, DiffKBM)]
    assert (paths[0] - paths[1]).norm(dim=-1).max() < 0.15


@pytest.mark.parametrize("straight_s", [0.0, 0.5, 2.0])
def test_a_turn_is_straight_before_and_after_for_as_long_as_asked(straight_s: float) -> None:
    turn = Turn(4.0, math.pi / 2, 6.0, ramp_s=1.0, straight_s=straight_s)
    steer, ends = turn(1.05, 0.1).steer, round(10 * straight_s)
    turning = steer[ends : len(steer) - ends]
    assert (steer[:ends] == 0).all()
    assert steer[len(steer) - ends :].abs().sum() < 1e-9
    # a ramp turns half as far as the same time at the full curvature
    assert len(turning) == round(10 * (math.pi / 2 * 6.0 / 4.0 + 1.0))
    assert (turning[1:] > 0).all()


class Unbounded(DiffKBM):
    """Leaves the numbers there are within half a second."""

    def step(self, state, control):
        return super().step(state, control) * 1e100


def test_a_drive_that_leaves_the_numbers_is_told_with_time_and_column():
    told = r"`states` must stay finite, but got \w+ = (nan|inf) after 0.4 s with Unbounded. Look at"
    with pytest.raises(ValueError, match=told):
        run(Unbounded, Slalom(3.0, 0.02, 6.0))


def test_numbers_keep_their_double_precision():
    assert Braking(4.0, -3.1)(1.05, 0.1).acceleration[-1].item() == -3.1
    given = [torch.tensor([[0.7, 0.0]] * 5, dtype=torch.float64) for _ in range(2)]
    whole = LaggedTruth(acceleration_lag_s=0.3, drag=0.0)(given[0], 1.1, 0.1)
    assert whole.intended_speed[0].item() == 1.1 + 0.1 * 0.7
    wide = LaggedTruth(acceleration_lag_s=0.3 * (1 + 1e-9), drag=0.0)(given[1], 1.1, 0.1)
    assert (whole.speed != wide.speed).all()


def test_braking_stops_the_vehicle():
    motion = run(DiffGM3, Braking(4.0)).motion
    assert motion.velocity[-1].norm() < 0.05


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("kind", "given", "told"),
    [
        (Braking, {"acceleration_mps2": 0.0}, "`acceleration_mps2` must be negative, as it brakes"),
        (Braking, {"acceleration_mps2": 3.0}, "`acceleration_mps2` must be negative, as it brakes"),
        (
            Braking,
            {"acceleration_mps2": -1e-9},
            "`manoeuvre` must take at most 3600 s, but got 5e+",
        ),
        (Braking, {"acceleration_mps2": math.nan}, "`acceleration_mps2` must lie in"),
        (Braking, {"hold_s": -1.0}, "`hold_s` must be at least 0"),
        (Slalom, {"periods": 0}, "`periods` must be at least 1"),
        (Slalom, {"periods": 1.5}, "`periods` must be a whole number"),
        (Slalom, {"period_s": 1e9}, "`manoeuvre` must take at most 3600 s"),
        (Slalom, {"period_s": 0.0}, "`period_s` must be positive"),
        (Slalom, {"curvature": math.inf}, "`curvature` must lie in [-1000, 1000]"),
        (Slalom, {"speed_mps": -1.0}, "`speed_mps` must lie in [0, 1000]"),
        (Turn, {"speed_mps": 1e-9}, "Give a higher speed_mps, or a smaller radius_m."),
        (Turn, {"angle_rad": math.nan}, "`angle_rad` must lie in [-1000, 1000]"),
        (Turn, {"straight_s": -1.0}, "`straight_s` must be at least 0"),
        (Turn, {"straight_s": 1799.5}, "`manoeuvre` must take at most 3600 s"),
        (Turn, {"acceleration_mps2": math.inf}, "`acceleration_mps2` must lie in"),
        (RecordedControls, {"speed_mps": math.nan}, "`speed_mps` must lie in [0, 1000]"),
    ],
)
def test_numbers_that_make_no_manoeuvre_are_refused(kind, given, told):
    usual = {
        Braking: {"speed_mps": 5.0},
        Slalom: {"speed_mps": 5.0, "curvature": 0.1, "period_s": 4.0},
        Turn: {"speed_mps": 5.0, "angle_rad": 1.0, "radius_m": 6.0},
        RecordedControls: {"path": "none.csv"},
    }[kind]
    with pytest.raises(ValueError, match="must") as raised:
        kind(**{**usual, **given})
    assert told in str(raised.value)


def test_recorded_controls_are_driven_and_saved(tmp_path):
    (tmp_path / "controls.csv").write_text("acceleration_mps2,steer_rad\n0.5,0.0\n0.5,0.1\n")
    recorded = RecordedControls(tmp_path / "controls.csv", 2.0)
    found = run(DiffGM3, recorded)
    save_run(tmp_path / "out.csv", DiffGM3(SPEC), found)
    lines = (tmp_path / "out.csv").read_text().splitlines()
    assert lines[0].startswith("time_s,position_x")
    assert lines[0].endswith("acceleration,steer")
    assert len(lines) == 4
    assert wheel_history(DiffGM3(SPEC).double(), found).normal_load.shape == (2, 2)


@pytest.mark.parametrize(
    "text", ["a,b\n1,2\n", "acceleration_mps2,steer_rad\n", "acceleration_mps2,steer_rad\n1,nan\n"]
)
def test_file_without_controls_is_refused(tmp_path, text):
    (tmp_path / "controls.csv").write_text(text)
    with pytest.raises(ValueError, match="`controls` must"):
        RecordedControls(tmp_path / "controls.csv")(1.0, 0.1)


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("time_s,acceleration_mps2,steer_rad,note\n3.0,0.5,0.1,x\n3.1,0.6,0.2,y\n", "utf-8"),
        (" time_s , acceleration_mps2, steer_rad \n3.0, 0.5, 0.1\n 3.1 ,0.6 , 0.2 \n", "utf-8-sig"),
        ("steer_rad,acceleration_mps2\n0.1,0.5\n0.2,0.6\n", "utf-8"),
    ],
    ids=["a clock and other columns", "a byte order mark and blanks", "another order"],
)
def test_tables_of_controls_are_read_by_their_columns(tmp_path, text, encoding):
    (tmp_path / "controls.csv").write_text(text, encoding=encoding)
    inputs = RecordedControls(tmp_path / "controls.csv")(1.0, 0.1)
    assert inputs.acceleration.tolist() == [0.5, 0.6]
    assert inputs.steer.tolist() == [0.1, 0.2]


def test_truth_follows_its_commands_with_a_lag():
    command = torch.tensor([1.0, 0.05]).double().expand(30, 2)
    signals = LaggedTruth(drag=0.0)(command, 3.0, 0.1)
    assert signals.realised[0, 0] < 0.3
    assert signals.realised[-1].tolist() == pytest.approx([1.0, 0.05], rel=1e-3)


def test_kinematic_model_is_near_the_truth_when_handed_its_signals():
    profile = command_profiles()["S-curve"]
    raw, realised = (score(SPEC, profile, VARIANTS[letter]) for letter in ("B", "C"))
    assert realised.kbm_m < 0.2 < raw.kbm_m
    assert raw.gm3_m == pytest.approx(realised.gm3_m)


def test_left_and_right_score_alike():
    chosen = command_profiles()
    left, right = (score(SPEC, chosen[f"{side} turn"], VARIANTS["E"]) for side in ("left", "right"))
    assert left == pytest.approx(right, rel=1e-6)


@pytest.mark.parametrize("speed_mps", [6.0, 9.0])
def test_the_truth_turns_no_sharper_than_its_grip_allows(speed_mps):
    command = torch.tensor([0.0, 1.0]).double().expand(30, 2)
    signals = LaggedTruth(drag=0.0, friction=0.5)(command, speed_mps, 0.1)
    assert float(signals.realised[-1, 1]) == pytest.approx(0.5 * 9.81 / speed_mps**2, rel=1e-3)
