"""The table of predictions: data sets side by side, seeds averaged, gaps told."""

import pytest

from diffstack_mmv.metrics import PREDICTED
from diffstack_mmv.reporting import Run, prediction_table, write_json

MODELS = {"unicycle": "Trajectron++"}


def write_scores(folder, shift, goal="predicted"):
    modes = {"pedestrian": dict.fromkeys(PREDICTED, 1.0 + shift) | {"nll_constant_velocity": 1.5}}
    baselines = {"constant_velocity": {"pedestrian": {"ade": 2.0, "fde": 4.0}}}
    if goal == "future":
        baselines["constant_acceleration"] = {"pedestrian": {"ade": 0.1, "fde": 0.0}}
    write_json(folder / "metrics.json", {"modes": modes, "baselines": baselines, "goal": goal})


@pytest.fixture
def runs(tmp_path):
    made = []
    for data in ("eth", "hotel"):
        for seed in (0, 1):
            folder = tmp_path / data / str(seed)
            write_scores(folder, 0.2 * seed)
            made.append(Run(data, "pedestrian", "unicycle", "predicted", seed, folder))
    return made


def test_seeds_and_data_sets_are_averaged(runs):
    table = prediction_table(runs, MODELS).set_index("method, ADE / FDE [m]")
    assert list(table.columns) == ["eth", "hotel", "mean"]
    assert set(table.loc["Trajectron++, best of 20 paths"]) == {"1.10 / 1.10"}
    assert table.loc["constant velocity", "mean"] == "2.00 / 4.00"


def test_a_run_that_has_not_ended_is_no_part_of_a_mean(runs):
    (runs[3].report / "metrics.json").unlink()
    row = (
        prediction_table(runs, MODELS)
        .set_index("method, ADE / FDE [m]")
        .loc["Trajectron++, one path (median)"]
    )
    assert row["eth"] == "1.10 / 1.10"
    assert row["hotel"] == row["mean"] == "–"


def test_modes_of_one_set_are_not_averaged(runs):
    riders = runs[0]._replace(mode="bicycle", report=runs[0].report.parent / "riders")
    modes = {"bicycle": dict.fromkeys(PREDICTED, 3.0)}
    write_json(
        riders.report / "metrics.json", {"modes": modes, "baselines": {}, "goal": "predicted"}
    )
    row = (
        prediction_table([*runs, riders], MODELS)
        .set_index("method, ADE / FDE [m]")
        .loc["Trajectron++, one path (median)"]
    )
    assert row["eth, pedestrian"] == row["hotel"] == "1.10 / 1.10"
    assert row["eth, bicycle"] == "3.00 / 3.00"


def test_a_path_that_an_earlier_version_did_not_score_is_told_by_a_dash(runs):
    for run in runs[2:]:
        own = {name: 1.0 for name in PREDICTED if not name.startswith("mean_")}
        told = {"modes": {"pedestrian": own}, "baselines": {}, "goal": "predicted"}
        write_json(run.report / "metrics.json", told)
    row = (
        prediction_table(runs, MODELS)
        .set_index("method, ADE / FDE [m]")
        .loc["Trajectron++, one path (mean)"]
    )
    assert row["eth"] == "1.10 / 1.10"
    assert row["hotel"] == row["mean"] == "–"


def test_a_path_that_is_led_to_the_humans_goal_is_no_prediction(runs):
    """Its FDE of 0.00 stood among those of predictions."""
    for run in runs:
        write_scores(run.report, 0.0, "future")
    methods = list(prediction_table(runs, MODELS)["method, ADE / FDE [m]"])
    assert "constant velocity" in methods
    assert "constant acceleration" not in methods
