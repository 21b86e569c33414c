"""The command that drives a vehicle open loop."""

import os
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

ROOT = Path(__file__).resolve().parents[2]


def simulate(*arguments):
    """Run scripts/simulate.py in a process of its own."""
    command = [sys.executable, str(ROOT / "scripts" / "simulate.py"), *arguments]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)


@pytest.fixture
def controls(tmp_path):
    """A CSV file: two seconds of a gentle left turn."""
    path = tmp_path / "controls.csv"
    pd.DataFrame({"acceleration_mps2": [0.2] * 20, "steer_rad": [0.1] * 20}).to_csv(path)
    return path


def test_recorded_controls_drive_all_models_beside_each_other(controls, tmp_path):
    done = simulate("vehicle=scooter", f"controls={controls}", "speed_mps=4", f"out={tmp_path}")
    assert done.returncode == 0, done.stderr
    ends = {
        name: pd.read_csv(tmp_path / f"trajectory_{name}.csv").iloc[-1]
        for name in ("gm3", "kbm", "unicycle")
    }
    assert all(end["heading"] > 0.3 for end in ends.values())
    for figure in ("runs.png", "wheels_gm3.png"):
        assert (tmp_path / figure).stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(p.stem for p in (ROOT / "configs/manoeuvre").iterdir()))
def test_every_manoeuvre_runs(name, tmp_path):
    done = simulate(f"manoeuvre={name}", f"out={tmp_path}")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("acceleration_mps2\n0.1\n", "steer_rad"),
        ("acceleration_mps2,steer_rad\n0.1,0.2\n0.1,nan\n", "[0.1, nan] in row 2"),
        ("acceleration_mps2,steer_rad\n", "at least one row"),
    ],
)
def test_bad_controls_end_with_one_message(content, told, tmp_path):
    path = tmp_path / "controls.csv"
    path.write_text(content)
    done = simulate(f"controls={path}", f"out={tmp_path / 'out'}")
    assert done.returncode != 0
    assert "Traceback" not in done.stderr
    assert told in done.stderr
    assert "controls.csv" in done.stderr
