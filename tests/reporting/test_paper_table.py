"""The table of the paper: every run is shown or told to be missing."""

import numpy as np
import pandas as pd
import pytest

from diffstack_mmv.metrics import OPEN_LOOP
from diffstack_mmv.reporting import Run, paper_table, write_paper_table
from diffstack_mmv.reporting.paper_table import bootstrap
from tests.reporting.runs import write_run

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
    assert list(table["seeds"]) == ["2/2", "2/2", "0/2", "-"]
    assert list(table["n"]) == ["40", "40", "-", "-"]
    assert table.iloc[3]["ADE [m]"] == "2.000"
    assert set(table.iloc[2].drop(["data", "goal", "mode", "model", "seeds"])) == {"-"}


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
    values, recordings = pd.Series(np.repeat([0.0, 1.0], 500)), pd.Series(np.repeat([0, 1], 500))
    assert bootstrap(values, recordings, 200) == (0.0, 1.0)
    assert np.isnan(bootstrap(values, recordings * 0, 200)).all()


def test_files_and_remarks(runs, tmp_path):
    table = paper_table(runs, MODELS, OPEN_LOOP, resamples=20)
    write_paper_table(tmp_path, table, ["imptc: no recordings in data/imptc."])
    assert "- imptc: no recordings" in (tmp_path / "results.md").read_text()
    assert len(pd.read_csv(tmp_path / "results.csv")) == len(table)
    assert r"\begin{tabular}" in (tmp_path / "results.tex").read_text()
