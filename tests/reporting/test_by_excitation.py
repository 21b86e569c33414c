"""Models compared by how hard the human rode."""

from functools import partial

import numpy as np
import pandas as pd
import pytest

from diffstack_mmv.metrics import EXCITATION, LATERAL, SPEED
from diffstack_mmv.plotting import save_by_excitation
from diffstack_mmv.reporting import bootstrap, by_excitation, paired_samples, write_by_excitation
from tests.reporting.runs import samples, write_run

TITLES = {each.name: each.heading for each in EXCITATION}


def ridden(gain=0.0):
    """Samples of which the hard-ridden half is judged worse by `gain`."""
    frame = samples()
    count = np.arange(len(frame))
    frame["agent"], frame["row"] = "ego", count
    frame[LATERAL], frame[SPEED] = np.where(count % 2 == 0, 2.5, 0.2), 5.0
    frame["plan_ade"] += np.where(frame[LATERAL] > 1, gain, 0.0)
    return frame


def runs(folder, gain=0.3):
    return [
        write_run(folder / "kbm", "kbm", 0, frame=ridden(gain)),
        write_run(folder / "gm3", "gm3", 0, frame=ridden()),
    ]


def test_the_difference_is_where_the_human_rode_hard(tmp_path):
    table = by_excitation(paired_samples(runs(tmp_path), "plan_ade", EXCITATION))
    bicycles = table[(table["mode"] == "bicycle") & (table["by"] == TITLES[LATERAL])]
    shift = dict(zip(bicycles["range"], bicycles["Δ"], strict=True))
    assert shift == pytest.approx({"0 to 0.5": 0.0, "2 to 3": -0.3})
    assert set(bicycles["pair"]) == {"gm3 - kbm"}
    assert (bicycles["n"].sum(), table["low"].isna().any()) == (40, False)


def test_few_scenes_have_no_interval(tmp_path):
    frame = ridden().assign(scene=np.arange(60) % 3)
    folders = [write_run(tmp_path / name, name, 0, frame=frame) for name in ("kbm", "gm3")]
    paired = paired_samples(folders, "plan_ade", EXCITATION)
    table = by_excitation(paired)
    assert set(table["recordings"]) <= {1, 2, 3}
    assert table[["low", "high"]].isna().all(None)
    write_by_excitation(tmp_path, paired)
    rows = (tmp_path / "excitation.md").read_text().splitlines()[2:]
    assert all(row.replace(" ", "").endswith("|–|–|") for row in rows)


def test_samples_that_one_cannot_judge_count_for_none(tmp_path):
    frame = ridden()
    frame.loc[frame.index[:6], "plan_ade"] = np.nan
    folders = [runs(tmp_path)[0], write_run(tmp_path / "other", "gm3", 0, frame=frame)]
    assert len(paired_samples(folders, "plan_ade", EXCITATION).table) == len(frame) - 6


def test_a_rounding_error_of_the_excitation_costs_no_sample(tmp_path):
    """One run was judged on a GPU, say: the same number is rounded up there and down here."""
    frame = ridden()
    frame[LATERAL] = 2.0005 - 1e-7
    other = frame.assign(**{LATERAL: 2.0005 + 1e-7, SPEED: frame[SPEED] - 1e-7})
    folders = [
        write_run(tmp_path / "kbm", "kbm", 0, frame=frame),
        write_run(tmp_path / "gm3", "gm3", 0, frame=other),
    ]
    assert len(paired_samples(folders, "plan_ade", EXCITATION).table) == len(frame)


def test_reports_without_excitation_are_named(tmp_path, caplog):
    old = write_run(tmp_path / "old", "kbm", 0)
    paired = paired_samples([old], "plan_ade", EXCITATION)
    assert paired.models == []
    assert f"{old} has no excitation" in caplog.text
    assert by_excitation(paired).empty
    write_by_excitation(tmp_path, paired)
    assert not (tmp_path / "excitation.md").exists()


def test_it_is_written_and_drawn(tmp_path):
    paired = paired_samples(runs(tmp_path), "plan_ade", EXCITATION)
    write_by_excitation(tmp_path, paired)
    assert "gm3 - kbm" in (tmp_path / "excitation.md").read_text()
    interval, picture = partial(bootstrap, resamples=50), tmp_path / "excitation.png"
    save_by_excitation(picture, paired.by_setting(), paired.models, TITLES, "ADE [m]", interval)
    assert (tmp_path / "excitation.png").stat().st_size > 10_000


def test_a_model_that_is_missing_in_one_setting_takes_nothing_from_it(tmp_path):
    elsewhere = {"goal": "future", "frame": ridden()}
    folders = [
        *runs(tmp_path),
        *(write_run(tmp_path / f"{name}_goal", name, 0, **elsewhere) for name in ("kbm", "other")),
    ]
    table = by_excitation(paired_samples(folders, "plan_ade", EXCITATION))
    pairs = table.groupby("goal")["pair"].unique().map(list).to_dict()
    assert pairs == {"predicted": ["gm3 - kbm"], "future": ["kbm - other"]}
    assert table.groupby("goal")["n"].sum().nunique() == 1


def test_sets_of_one_kind_are_told_apart(tmp_path):
    folders = [*runs(tmp_path / "a", 0.3), *runs(tmp_path / "b", -0.3)]
    paired = paired_samples(folders, "plan_ade", EXCITATION, ["a", "a", "b", "b"])
    shift = by_excitation(paired).groupby("data")["Δ"].sum()
    assert shift["a"] == pytest.approx(-shift["b"])
    assert shift["a"] < -0.5


def test_a_mean_that_every_draw_has_is_sure_however_many_samples_a_recording_has():
    recordings = pd.Series(np.repeat(np.arange(8), [1, 2, 3, 4, 20, 30, 40, 50]))
    assert bootstrap(pd.Series(np.full(len(recordings), 2.5)), recordings) == (2.5, 2.5)
