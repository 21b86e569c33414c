"""The table of the paper: every run is shown or told to be missing."""

import numpy as np
import pandas as pd
import pytest

from diffstack_mmv.metrics import OPEN_LOOP
from diffstack_mmv.reporting import Run, paper_table, write_paper_table
from diffstack_mmv.reporting.bootstrapping import bootstrap
from tests.reporting.runs import samples, write_run

MODELS = {"unicycle": "DiffStack", "kbm": "DiffKBM", "gm3": "DiffGM3"}


@pytest.fixture
def runs(tmp_path):
    """Two seeds of two models; DiffKBM is 10 % worse, and DiffGM3 has not ended."""
    made = []
    for model in MODELS:
        for seed in (0, 1):
            folder = tmp_path / model / str(seed)
            if model != "gm3":
                write_run(folder, model, seed, shift=0.1 if model == "kbm" else 0.0)
            made.append(Run("thab_vru", "bicycle", model, "predicted", seed, folder))
    return made


def test_every_model_has_a_row_and_trivial_paths_follow(runs):
    table = paper_table(runs, MODELS, OPEN_LOOP, resamples=20)
    assert list(table["model"]) == ["DiffStack", "DiffKBM", "DiffGM3", "stand still"]
    assert list(table["seeds"]) == ["2/2", "2/2", "0/2", "–"]
    assert list(table["n"]) == ["40", "40", "–", "–"]
    assert table.iloc[3]["ADE [m]"] == "2.000"
    assert set(table.iloc[2].drop(["data", "goal", "mode", "model", "seeds"])) == {"–"}


@pytest.mark.parametrize(("goal", "forecast"), [("predicted", True), ("future", False)])
def test_a_path_that_is_led_to_the_goal_is_no_prediction(tmp_path, goal, forecast) -> None:
    led = {"straight_line/ade": 0.2, "straight_line/fde": 0.1, "stand_still/nll": 3.0}
    folder = write_run(tmp_path, "unicycle", 0, frame=samples().assign(**led), goal=goal)
    run = Run("thab_vru", "bicycle", "unicycle", goal, 0, folder)
    table = paper_table([run], MODELS, OPEN_LOOP, resamples=20).set_index("model")
    assert list(table.loc["stand still", ["ADE [m]", "plan ADE [m]"]]) == ["2.000", "2.000"]
    told = ["0.200" if forecast else "–", "0.200"]
    assert list(table.loc["straight line", ["ADE [m]", "plan ADE [m]"]]) == told


def test_differences_are_told_against_the_first_model(runs):
    table = paper_table(runs, MODELS, OPEN_LOOP, resamples=20)
    first, second = table["ADE [m]"][:2]
    assert "%" not in first
    mean = float(first.split()[0])
    change = 100 * (float(second.split()[0]) / mean - 1)
    told = float(second.split("%")[0].split(",")[-1])
    assert told == pytest.approx(change, abs=0.3)
    assert "±" in first


def test_a_score_that_may_be_negative_is_told_by_its_difference(runs):
    first, second = paper_table(runs, MODELS, OPEN_LOOP, resamples=20)["NLL [nats]"][:2]
    assert "%" not in second
    means = [float(cell.split()[0]) for cell in (first, second)]
    told = float(second.rsplit(",", 1)[-1].rstrip(")"))
    assert told == pytest.approx(means[1] - means[0], abs=1e-3)


def test_bootstrap_draws_recordings_and_not_samples():
    values, recordings = np.repeat(np.arange(8.0), 500), pd.Series(np.repeat(np.arange(8), 500))
    low, high = bootstrap(pd.Series(values), recordings, 2000)
    assert (low, high) == pytest.approx((2.0, 5.0), abs=0.3)
    for fewer in (1, 4, 7):
        assert np.isnan(bootstrap(pd.Series(values), recordings % fewer, 200)).all()


@pytest.mark.parametrize(("factor", "shift"), [(-1.0, 0.0), (2.0, 3.0), (-0.5, 1.0)])
def test_bootstrap_in_another_unit_is_the_same_interval(factor, shift) -> None:
    values = pd.Series(np.random.default_rng(0).exponential(size=80))
    recordings = pd.Series(np.repeat(np.arange(10), 8))
    ends = [factor * end + shift for end in bootstrap(values, recordings, 200)]
    found = bootstrap(factor * values + shift, recordings, 200)
    assert found == pytest.approx(sorted(ends), rel=1e-9)


def test_bootstrap_leaves_out_recordings_of_which_nothing_is_known():
    rng = np.random.default_rng(0)
    values, recordings = pd.Series(rng.normal(size=80)), pd.Series(np.repeat(np.arange(10), 8))
    unknown = recordings >= 8
    told = bootstrap(values.mask(unknown), recordings, 200)
    assert told == bootstrap(values[~unknown], recordings[~unknown], 200)
    assert np.isnan(bootstrap(values.mask(recordings >= 7), recordings, 200)).all()


def test_nothing_is_told_against_another_model_than_the_first(runs):
    for run in runs[:2]:
        (run.report / "metrics.json").unlink()
    cells = paper_table(runs, MODELS, OPEN_LOOP, resamples=20)["ADE [m]"]
    assert cells[0] == "–"
    assert "%" not in cells[1]


def test_a_rate_of_zero_everywhere_has_no_interval(tmp_path):
    folder = write_run(tmp_path, "unicycle", 0, frame=samples().assign(collision_rate=0.0))
    run = Run("thab_vru", "bicycle", "unicycle", "predicted", 0, folder)
    table = paper_table([run], MODELS, OPEN_LOOP, resamples=20)
    assert table["collisions"][0] == "0.000"


def test_files_and_remarks(runs, tmp_path):
    table = paper_table(runs, MODELS, OPEN_LOOP, resamples=20)
    write_paper_table(tmp_path, table, ["imptc: no recordings in data/imptc."])
    text = (tmp_path / "results.md").read_text()
    assert "- imptc: no recordings" in text
    assert all(model in text for model in MODELS.values())
    assert len(pd.read_csv(tmp_path / "results.csv")) == len(table)
    assert r"\begin{tabular}" in (tmp_path / "results.tex").read_text()


def test_a_table_of_nothing_says_so(tmp_path):
    write_paper_table(tmp_path, paper_table([], MODELS, OPEN_LOOP), [])
    assert (tmp_path / "results.md").read_text() == "No run has ended.\n"


def test_seeds_are_averaged_by_sample_and_not_by_row(runs):
    table = paper_table(runs, MODELS, OPEN_LOOP, resamples=20)
    frame = samples(1)
    write_run(runs[1].report, "unicycle", 1, frame=frame.iloc[::-1].reset_index(drop=True))
    again = paper_table(runs, MODELS, OPEN_LOOP, resamples=20)
    assert again["ADE [m]"][0] == table["ADE [m]"][0]


@pytest.mark.parametrize(("kept", "shift", "count"), [(60, 1, 40), (57, 0, 38)])
def test_seeds_that_were_judged_on_different_windows_are_refused(runs, kept, shift, count):
    frame = samples(1).assign(row=np.arange(60) + shift)[:kept]
    write_run(runs[1].report, "unicycle", 1, frame=frame)
    told = rf"were judged on different windows of bicycle \({count} and 40\)"
    with pytest.raises(ValueError, match=told):
        paper_table(runs, MODELS, OPEN_LOOP, resamples=20)
