"""The command that drives a vehicle open loop."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

MANOEUVRES = sorted(Path(__file__).resolve().parents[2].glob("configs/manoeuvre/*.yaml"))
SIDES = {
    **{"braking": 0, "left_turn": 1, "left_u_turn": 1, "right_turn": -1, "right_u_turn": -1},
    **{"s_curve": 1, "slalom": 1},
}
"""Sign of the change of heading where it is largest: to the left is positive."""


@pytest.fixture
def controls(tmp_path):
    """A CSV file: two seconds of a gentle left turn."""
    path = tmp_path / "controls.csv"
    pd.DataFrame({"acceleration_mps2": [0.2] * 20, "steer_rad": [0.1] * 20}).to_csv(path)
    return path


def test_recorded_controls_drive_all_models_beside_each_other(succeed, controls, tmp_path):
    succeed("simulate", "vehicle=scooter", f"controls={controls}", "speed_mps=4", f"out={tmp_path}")
    ends = {
        name: pd.read_csv(tmp_path / f"trajectory_{name}.csv").iloc[-1]
        for name in ("gm3", "kbm", "unicycle")
    }
    assert all(end["heading"] > 0.3 for end in ends.values())
    for figure in ("runs.png", "wheels_gm3.png"):
        assert (tmp_path / figure).stat().st_size > 10_000


def test_a_drive_of_other_settings_is_no_part_of_the_same_folder(succeed, refusal, tmp_path):
    given = ["others.unicycle=null", "others.kbm=null", "dynamics=kbm", f"out={tmp_path}"]
    succeed("simulate", *given)
    before = {file: file.read_bytes() for file in tmp_path.glob("*.csv")}
    for changed, told in (
        ("vehicle=scooter", "`out` must hold no result of simulate with another "),
        ("dynamics=unicycle", "`out` must hold no result of simulate with another dynamics."),
        ("speed_mps=3", "another speed_mps than 3, but got 5.0 in"),
    ):
        assert told in refusal("simulate", *given, changed)
    assert {file: file.read_bytes() for file in tmp_path.glob("*.csv")} == before
    succeed("simulate", *given)


@pytest.mark.slow
@pytest.mark.parametrize("name", [path.stem for path in MANOEUVRES])
def test_every_manoeuvre_turns_to_its_side_with_every_model(succeed, name, tmp_path):
    succeed("simulate", f"manoeuvre={name}", f"out={tmp_path}")
    headings = [pd.read_csv(file)["heading"] for file in tmp_path.glob("trajectory_*.csv")]
    farthest = [each[each.abs().idxmax()] for each in headings]
    assert len(farthest) == 3
    assert {np.sign(each.round(6)) for each in farthest} == {SIDES[name]}


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("acceleration_mps2\n0.1\n", "steer_rad"),
        ("acceleration_mps2,steer_rad\n0.1,0.2\n0.1,nan\n", "[0.1, nan] in row 2"),
        ("acceleration_mps2,steer_rad\n", "at least one row"),
    ],
)
def test_bad_controls_end_with_one_message(refusal, content, told, tmp_path):
    path = tmp_path / "controls.csv"
    path.write_text(content)
    message = refusal("simulate", f"controls={path}", f"out={tmp_path / 'out'}")
    assert told in message
    assert "controls.csv" in message
