"""The table of an ablation: a row per set, seeds counted, trivial paths once."""

import json

import pytest

from diffstack_mmv.reporting import Run, ablation_table, write_json, write_paper_table

SCORES = ("median_ade", "nll", "energy_score", "coverage_50", "coverage_90")


def write_scores(folder, value, situations=("moving", "standing")):
    trivial = {"kalman": {"ade": 5.0}}
    told = {
        "goal": "predicted",
        "modes": {"bicycle": dict.fromkeys(SCORES, value) | {"nll_kalman": 1.5, "n": 7}},
        "baselines": {"kalman": {"bicycle": {"ade": 4.0}}},
        "situations": {
            "bicycle": {
                name: {"median_ade": 2 * value, "baselines": trivial} for name in situations
            }
        },
    }
    write_json(folder / "metrics.json", told)


@pytest.fixture
def runs(tmp_path):
    made = []
    for number, data in enumerate(("present", "without")):
        for seed in (0, 1):
            folder = tmp_path / data / str(seed)
            write_scores(folder, 1.0 + number + 0.2 * seed)
            made.append(Run(data, "bicycle", "kbm", "predicted", seed, folder))
    return made


def test_each_set_is_a_row_and_trivial_paths_follow(runs):
    table = ablation_table(runs, {"kbm": "DiffKBM"}).set_index("")
    assert list(table.index) == ["present", "without", "kalman"]
    assert table.loc["without", "windows"] == "7"
    assert table.loc["without", "ADE of the median [m]"] == "2.100 ± 0.141"
    assert table.loc["present", "moving"] == "2.200 ± 0.283"
    assert table.loc["kalman", "NLL [nats]"] == "1.500"
    assert table.loc["kalman", "standing"] == "5.000"
    assert table.loc["kalman", "50 % region"] == "–"


def test_a_run_that_has_not_ended_is_counted_and_no_part_of_a_mean(runs):
    (runs[1].report / "metrics.json").unlink()
    row = ablation_table(runs, {"kbm": "DiffKBM"}).set_index("").loc["present"]
    assert (row["seeds"], row["ADE of the median [m]"]) == ("1 of 2", "1.000")


def test_digits_are_kept_in_the_file(runs, tmp_path):
    write_paper_table(tmp_path, ablation_table(runs, {"kbm": "DiffKBM"}), [])
    assert "| 4.000 " in (tmp_path / "results.md").read_text(encoding="utf-8")


def test_a_set_without_any_result_has_dashes(runs):
    for run in runs[:2]:
        (run.report / "metrics.json").unlink()
    table = ablation_table(runs, {"kbm": "DiffKBM"}).set_index("")
    assert (table.loc["present", "seeds"], table.loc["present", "NLL [nats]"]) == ("0 of 2", "–")
    assert table.loc["kalman", "ADE of the median [m]"] == "4.000"


def test_where_nobody_stands_there_is_a_dash(tmp_path):
    """As on the bikers of SDD."""
    write_scores(tmp_path, 1.0, ("moving",))
    run = Run("riders", "bicycle", "kbm", "predicted", 1, tmp_path)
    table = ablation_table([run], {"kbm": "DiffKBM"}).set_index("")
    assert list(table["standing"]) == ["–", "–"]
    assert list(table["moving"]) == ["2.000", "5.000"]


def test_a_score_that_judged_no_sample_is_a_dash_and_no_part_of_a_mean(runs):
    """As the regions with a horizon of less than three steps; it was an error."""
    told = json.loads((runs[0].report / "metrics.json").read_text())
    told["modes"]["bicycle"] |= {"nll": None, "coverage_50": None}
    write_json(runs[0].report / "metrics.json", told)
    (runs[1].report / "metrics.json").unlink()
    row = ablation_table(runs[:2], {"kbm": "DiffKBM"}).set_index("").loc["present"]
    assert (row["NLL [nats]"], row["50 % region"], row["90 % region"]) == ("–", "–", "1.000")
    write_scores(runs[1].report, 1.2)
    row = ablation_table(runs[:2], {"kbm": "DiffKBM"}).set_index("").loc["present"]
    assert (row["NLL [nats]"], row["90 % region"]) == ("1.200", "1.100 ± 0.141")


def test_a_path_that_is_led_to_the_humans_goal_is_no_prediction(runs):
    for run in runs:
        told = json.loads((run.report / "metrics.json").read_text()) | {"goal": "future"}
        told["baselines"]["constant_acceleration"] = {"bicycle": {"ade": 0.1}}
        write_json(run.report / "metrics.json", told)
    assert list(ablation_table(runs, {"kbm": "DiffKBM"})[""]) == ["present", "without", "kalman"]
