"""One table from many drives."""

import json

import pandas as pd
import pytest

from diffstack_mmv.metrics import CLOSED_LOOP
from diffstack_mmv.reporting import DrivenRow, joint_table, write_joint_table
from diffstack_mmv.reporting.joint_table import FAILURES, joint_pairs


def told(outcomes):
    """What a drive over cases with these outcomes writes."""
    rate = outcomes.count("success") / len(outcomes)
    cases = [
        {"case": number, "outcome": outcome, "time_s": 3.0 + number, "steps": 10,
         "min_clearance_m": 0.1, "discomfort_steps": number}
        for number, outcome in enumerate(outcomes)
    ]  # fmt: skip
    rates = {"success_rate": rate, "collision_rate": 1 - rate, "incomplete_rate": 0.0}
    intervals = {f"{name}_ci95": [0.1, 0.9] for name in ("success_rate", "collision_rate")}
    return rates | intervals | {
        "nav_time_s": 3.5, "discomfort_frequency": 0.1, "mean_episode_min_dist_m": 0.3,
        "n": len(outcomes), "phase": "val", "first_case": 0, "footprint": "disc",
        "real_time_factor": 12.3, "solved_share": None, "cases": cases,
        "feasible": {"n": 1, "success_rate": 1.0, "collision_rate": 0.0},
    }  # fmt: skip


@pytest.fixture
def rows(tmp_path):
    """Two drives over the same cases, and one that has not ended."""
    driven = {"first": ["success", "collision"], "second": ["collision", "collision"]}
    for name, outcomes in driven.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "closed_loop.json").write_text(json.dumps(told(outcomes)))
    against = {"second": ("first", "absent")}
    names = (*driven, "absent")
    return [DrivenRow("circle", name, tmp_path / name, against.get(name, ())) for name in names]


@pytest.mark.parametrize(("radius_m", "fits"), [(0.3, True), (1.5, False)])
def test_rows_over_cases_that_were_drawn_otherwise_are_not_compared(rows, radius_m, fits) -> None:
    for row, radius in zip(rows[:2], (0.3, radius_m), strict=True):
        drawn_by = {"drawn_by": {"robot_radius_m": radius}}
        row.result.write_text(json.dumps(json.loads(row.result.read_text()) | drawn_by))
    if fits:
        assert len(joint_pairs(rows, CLOSED_LOOP)) == 1
    else:
        with pytest.raises(ValueError, match="`against` must name runs with drawn_by"):
            joint_pairs(rows, CLOSED_LOOP)


@pytest.mark.parametrize(
    ("row", "column", "cell"),
    [
        ("first", "success", "0.500 [0.100, 0.900]"),
        ("first", "cases", "val 0–1"),
        ("first", "feasible: n, success, collision", "1, 1.000, 0.000"),
        ("first", "real-time factor", "12.3"),
        ("absent", "success", "–"),
    ],
)
def test_every_drive_is_a_row_and_one_under_way_has_no_numbers(rows, row, column, cell):
    assert joint_table(rows, CLOSED_LOOP).set_index("row").loc[row, column] == cell


def test_the_files_hold_table_pairs_and_failures(rows, tmp_path):
    write_joint_table(tmp_path / "out", "A title", rows, CLOSED_LOOP, ["remark"])
    text = (tmp_path / "out" / "table.md").read_text()
    assert "# A title" in text
    assert "- remark" in text
    assert "0 / 1" in text.split("Paired")[1]
    assert "(2 p values, not corrected; by Bonferroni 0.05 is 0.025)" in text
    assert (tmp_path / "out" / "table.tex").is_file()
    assert len((tmp_path / "out" / "table.csv").read_text().splitlines()) == 4
    failures = (tmp_path / "out" / "failures.csv").read_text().splitlines()
    assert failures[:2] == [",".join(FAILURES), "circle,first,1,collision,4.000,–"]
    assert len(failures) == 4


@pytest.mark.parametrize(("name", "mark"), [("table.md", "|"), ("table.tex", "&")])
def test_markdown_and_latex_hold_the_cells_of_the_csv(rows, tmp_path, name, mark):
    write_joint_table(tmp_path, "A title", rows, CLOSED_LOOP)
    held = pd.read_csv(tmp_path / "table.csv", dtype=str)
    assert held.loc[0, "incomplete"] == "0.000"
    lines = (tmp_path / name).read_text().replace("\\\\", mark).splitlines()
    shown = [[cell.strip() for cell in line.strip(f"{mark} ").split(mark)] for line in lines]
    assert [each for each in held.to_numpy().tolist() if each not in shown] == []


def test_a_table_without_a_failure_lists_none(rows, tmp_path):
    write_joint_table(tmp_path, "A title", rows[2:], CLOSED_LOOP)
    assert len(pd.read_csv(tmp_path / "failures.csv")) == 0
