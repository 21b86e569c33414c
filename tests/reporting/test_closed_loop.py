"""The report of a closed-loop benchmark."""

import json

import pytest

from diffstack_mmv.metrics import CLOSED_LOOP
from diffstack_mmv.reporting import closed_loop_table, write_closed_loop


@pytest.fixture
def numbers():
    rates = {"success_rate": 0.5, "collision_rate": 0.5, "incomplete_rate": 0.0}
    others = {
        "nav_time_s": 3.5, "nav_time_all_s": 3.0, "discomfort_frequency": 0.1,
        "avg_min_dist_m": None, "mean_episode_min_dist_m": 0.3,
    }  # fmt: skip
    cases = [
        {"case": 0, "outcome": "success", "time_s": 3.5, "min_clearance_m": 0.4},
        {"case": 1, "outcome": "collision", "time_s": 2.5, "min_clearance_m": -0.01},
    ]
    return rates | others | {
        "n": 2, "success_rate_ci95": [0.1, 0.9], "collision_rate_ci95": [0.1, 0.9],
        "control_time_ms": {"median": 1.0, "p99": 2.0}, "cases": cases,
    }  # fmt: skip


@pytest.fixture
def result(numbers):
    return numbers | {
        "vehicle": "bicycle", "dynamics": "kbm", "scenario": "circle_crossing",
        "controller": "diffmpc", "limit_s": 10.0, "dt_s": 0.25, "verdict": "exact", "humans": 5,
        "phase": "test", "first_case": 0, "chunk": 50, "limits": {"speed_max_mps": 3.0},
        "robot_visible": False, "choices": {"crowd": "orca", "people": "predictor"},
        "disturbances": {"delay_s": 0.0, "noise": [], "friction": None, "mass_factor": 1.0},
        "believed_dynamics": "gm3",
        "actual_model": {
            "class": "DiffKBM", "tyre_law": None, "step_s": 0.01, "substeps": 1,
            "footprint": {"shape": "disc", "radius_m": 0.3},
        },
        "believed_model": {
            "class": "DiffGM3", "tyre_law": "PaperBrush(steepness=100)", "step_s": 0.25,
            "substeps": 2, "footprint": {"shape": "disc", "radius_m": 0.3},
        },
    }  # fmt: skip


def test_every_method_is_a_row_with_its_interval(result, numbers):
    table = closed_loop_table(result, {"orca": numbers}, CLOSED_LOOP)
    assert list(table.index) == ["diffmpc (kbm bicycle)", "orca"]
    assert table.loc["orca", "success"] == "0.500 [0.100, 0.900]"
    assert table.loc["orca", "distance in discomfort [m]"] == "–"
    assert table.loc["orca", "decision median / p99 [ms]"] == "1.0 / 2.0"
    assert list(table.columns) == ["n", *(score.heading for score in CLOSED_LOOP.values())]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({}, "do not see the robot; crowd `orca`, people `predictor`. Brackets"),
        ({"robot_visible": True}, "The pedestrians see the robot"),
        ({"data": "citr"}, "\nUp to 5 agents at once of the recordings of citr, test cases 0–1"),
        (
            {"disturbances": {"delay_s": 0.15, "noise": [0.2, 0.0], "friction": 0.3}},
            "`predictor`. Disturbances: delay_s 0.15, noise [0.2, 0.0], friction 0.3. Brackets",
        ),
        (
            {"disturbances": {"delay_s": 1.0, "friction": 1.0, "believed_mass_factor": 1.0}},
            "`predictor`. Disturbances: delay_s 1.0, friction 1.0. Brackets",
        ),
    ],
    ids=["as it is", "visible", "recorded", "disturbed", "disturbed by one"],
)
def test_what_decides_the_scores_stands_above_them(result, given, told, tmp_path):
    write_closed_loop(tmp_path, result | given, {}, CLOSED_LOOP, [])
    assert told in (tmp_path / "closed_loop.md").read_text()


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ({"scenario": "circle_crossing", "humans": 5}, True),
        ({"scenario": "square_crossing", "humans": 5}, False),
        ({"scenario": "circle_crossing", "humans": 20}, False),
        ({}, True),
    ],
    ids=["same", "other scenario", "other number of people", "none named"],
)
def test_only_published_rows_of_the_same_setting_stand_beside_a_drive(
    result, setting, told, tmp_path
):
    write_closed_loop(tmp_path, result, {}, CLOSED_LOOP, [{"method": "SARL"} | setting])
    report = (tmp_path / "closed_loop.md").read_text()
    assert ("SARL" in report) is told
    assert ("## Published methods" in report) is told


def test_the_file_that_says_that_a_drive_is_done_is_written_last(
    result, numbers, tmp_path, monkeypatch
):
    def killed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("diffstack_mmv.reporting.closed_loop.write_text", killed)
    with pytest.raises(KeyboardInterrupt):
        write_closed_loop(tmp_path, result, {"orca": numbers}, CLOSED_LOOP)
    assert not (tmp_path / "closed_loop.json").exists()


def test_files_hold_numbers_failures_and_sources(result, numbers, tmp_path):
    source = {"method": "SARL", "success": 0.9, "source": "Chen et al."}
    write_closed_loop(tmp_path, result, {"orca": numbers}, CLOSED_LOOP, [source])
    stored = json.loads((tmp_path / "closed_loop.json").read_text())
    assert stored["baselines"]["orca"]["n"] == 2
    report = (tmp_path / "closed_loop.md").read_text()
    assert "| collision |" in report.replace("  ", " ")
    assert "Chen et al." in report
    assert "test cases 0–1 in batches of up to 50, limit 10 s" in report
    assert "Footprint: disc (radius_m 0.3)" in report
    assert "kbm (DiffKBM, step 0.01 s)" in report
    assert "gm3 (DiffGM3, PaperBrush(steepness=100), step 0.25 s, 2 substeps)" in report
