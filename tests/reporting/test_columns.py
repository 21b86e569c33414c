"""Every column of every file, table and panel is a registered score or tells what a row is."""

import json

import pandas as pd
import pytest

from diffstack_mmv.callbacks.dashboard import MODE_SCORES as PANEL_SCORES
from diffstack_mmv.callbacks.dashboard import PANELS, panel_title
from diffstack_mmv.callbacks.plans import SHOWN
from diffstack_mmv.metrics import CLOSED_LOOP, OPEN_LOOP
from diffstack_mmv.reporting import compare, paired_tests, read_runs, write_comparison
from diffstack_mmv.reporting.metrics_table import BASELINE_SCORES
from diffstack_mmv.reporting.paired import OUTCOMES, SHIFTS
from tests.reporting.runs import write_run

HEADINGS = {score.heading for score in OPEN_LOOP.values()}
ABOUT_A_MODE = {"n", "n_missing", "vehicle"}
ABOUT_A_RUN = {"data", "split", "goal", "mode", "vehicle", "dynamics", "seeds"}
ABOUT_A_ROW = ABOUT_A_RUN | {"n", "pair", "recordings", "p", "p (Holm)"}


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    place = tmp_path_factory.mktemp("runs")
    runs = [write_run(place / name, name, 0, shift) for name, shift in (("kbm", 0), ("gm3", 1))]
    comparison = compare(read_runs(runs), OPEN_LOOP)
    write_comparison(place, comparison, paired_tests(runs, OPEN_LOOP["plan_ade"]))
    return place, runs[0]


def test_metrics_json(folders):
    metrics = json.loads((folders[1] / "metrics.json").read_text())
    for mode in metrics["modes"].values():
        assert set(mode) == ABOUT_A_MODE | set(OPEN_LOOP)
        assert set(mode) - ABOUT_A_MODE <= set(OPEN_LOOP)
    for baseline in metrics["baselines"].values():
        assert all(set(scores) == set(BASELINE_SCORES) for scores in baseline.values())
    assert {"ade", "fde"} == set(BASELINE_SCORES) <= set(OPEN_LOOP)


def test_metrics_csv_and_markdown(folders):
    columns = set(pd.read_csv(folders[1] / "metrics.csv").columns)
    assert columns - {"mode", "vehicle", "n"} == {OPEN_LOOP[name].heading for name in OPEN_LOOP}
    section = (folders[1] / "metrics.md").read_text().split("\n## ")[1]
    header, _, *rows = section.splitlines()[2:]
    assert header.strip("| ").startswith("score")
    assert columns - {"mode"} == {row.split("|")[1].strip() for row in rows}


def test_samples(folders):
    columns = pd.read_parquet(folders[1] / "samples.parquet").columns
    of_baselines = {name.split("/")[1] for name in columns if "/" in name}
    assert of_baselines <= set(OPEN_LOOP)
    scores = {name for name in columns if "/" not in name}
    assert scores - {"mode", "scene", "agent", "row", "moving", "standing"} == set(OPEN_LOOP)


@pytest.mark.parametrize("file", ["table.csv", "table.md", "table.tex", "tests.csv"])
def test_comparison(folders, file):
    first, *lines = (folders[0] / file).read_text().splitlines()
    line = lines[1] if file.endswith("tex") else first
    separator = {"csv": ",", "md": "|", "tex": "&"}[file.split(".")[1]]
    cells = {cell.strip(" \\").removeprefix("mean Δ ") for cell in line.strip("|").split(separator)}
    assert cells - ABOUT_A_ROW - {"better"} <= HEADINGS
    assert "plan ADE [m]" in cells


def test_dashboard():
    logged = [key for keys in PANELS.values() for key in keys]
    validated = {key.removeprefix("val/") for key in logged if key.startswith("val/")}
    assert (validated | set(PANEL_SCORES)) - {"n_missing"} <= set(OPEN_LOOP)
    assert set(SHOWN) <= set(OPEN_LOOP)
    titles = [panel_title(key) for key in logged]
    assert len(set(titles)) == len(titles)


@pytest.mark.parametrize(
    ("key", "title"),
    [
        ("val/ade", "ADE [m] (val)"),
        ("val/bicycle/plan_ade", "plan ADE [m] (val, bicycle)"),
        ("train/solved", "solved (train)"),
        ("gradient/cost", "gradient/cost"),
    ],
)
def test_panels_have_the_titles_of_their_scores(key, title):
    assert panel_title(key) == title


def test_paired_tests_of_episodes():
    assert set(OUTCOMES.values()) | set(SHIFTS.values()) <= set(CLOSED_LOOP)
