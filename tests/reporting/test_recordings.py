"""Scenes of one recording are no independent witnesses: intervals and tests go by recording."""

import numpy as np
import pandas as pd
import pytest

from diffstack_mmv.metrics import EXCITATION, LATERAL, OPEN_LOOP, SPEED
from diffstack_mmv.plotting import draw_by_excitation
from diffstack_mmv.reporting import Run, by_excitation, paired_samples, paired_tests, paper_table
from diffstack_mmv.reporting.compared_runs import with_recordings
from tests.reporting.runs import write_run

DRAWS, RECORDINGS, SCENES = 40, 12, 8


def judged(seed):
    """Scores whose mean is 0, drawn once per mode: 8 scenes of each of 12 recordings."""
    rng, count = np.random.default_rng(seed), DRAWS * RECORDINGS * SCENES
    number = np.arange(count)
    own = rng.normal(0, 0.7, count) + np.repeat(rng.normal(0, 1, DRAWS * RECORDINGS), SCENES)
    frame = pd.DataFrame(dict.fromkeys(OPEN_LOOP, 0.0) | {"plan_ade": own})
    frame["mode"] = [f"mode_{draw:02}" for draw in number // (RECORDINGS * SCENES)]
    frame["scene"] = [f"scene_{scene}" for scene in number]
    frame["recording"] = [f"recording_{recording}" for recording in number // SCENES]
    beside = {"agent": "ego", "row": 0, "moving": True, "standing": False}
    beside |= {"stand_still/ade": 2.0, "stand_still/fde": 4.0, LATERAL: 0.2}
    return frame.assign(**beside, **{SPEED: 5.0 + 0.01 * (number % SCENES)})


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """Two models that do not differ, and the same in reports that tell no recording."""
    place, frame = tmp_path_factory.mktemp("runs"), judged(0)
    frames = {"kbm": frame, "gm3": frame.assign(plan_ade=0.0)}
    told = [write_run(place / name, name, 0, frame=each) for name, each in frames.items()]
    untold = [
        write_run(place / "earlier" / name, name, 0, frame=each.drop(columns="recording"))
        for name, each in frames.items()
    ]
    return told, untold


def test_of_two_equal_models_one_is_seldom_called_better(reports):
    by_recording, by_scene = (paired_tests(each, OPEN_LOOP["plan_ade"]) for each in reports)
    assert set(by_recording["recordings"]) == {RECORDINGS}
    assert (by_recording["p"] < 0.05).mean() <= 0.1
    assert (by_scene["p"] < 0.05).mean() >= 0.3


def test_the_interval_of_a_difference_holds_the_truth(reports):
    shares = []
    for folders in reports:
        table = by_excitation(paired_samples(folders, "plan_ade", EXCITATION), resamples=200)
        shares.append(((table["low"] <= 0) & (table["high"] >= 0)).mean())
    assert shares[0] >= 0.85
    assert shares[1] <= 0.65


def test_the_table_of_the_paper_draws_recordings(reports):
    widths = []
    for folder, _ in reports:
        run = Run("thab_vru", "mode_00", "kbm", "predicted", 0, folder)
        cell = paper_table([run], {"kbm": "DiffKBM"}, OPEN_LOOP, 200)["plan ADE [m]"][0]
        low, high = cell.partition("[")[2].partition("]")[0].split(", ")
        widths.append(float(high) - float(low))
    assert widths[0] > 1.5 * widths[1]


def test_figures_draw_recordings(reports):
    seen = []

    def interval(values, recordings):
        seen.extend(recordings)
        return 0.0, 1.0

    paired = paired_samples(reports[0], "plan_ade", EXCITATION)
    (first, *_) = paired.by_setting().items()
    draw_by_excitation(dict([first]), paired.models, {SPEED: "speed"}, "plan ADE [m]", interval)
    assert {name.partition("_")[0] for name in seen} == {"recording"}


def test_an_earlier_report_takes_the_recordings_of_a_later_one():
    table = pd.DataFrame({"data": list("aaab"), "scene": ["1", "1", "2", "1"]})
    told = with_recordings(table.assign(recording=[None, "x", None, None]), ["data"])
    assert told["recording"].tolist() == ["x", "x", "2", "1"]
    assert with_recordings(table)["recording"].equals(table["scene"])
