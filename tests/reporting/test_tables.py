"""Result files: the contract's keys, atomic writing, comparison over runs."""

import json

import numpy as np
import pandas as pd
import pytest

from diffstack_mmv.reporting import (
    compare,
    paired_tests,
    read_json,
    read_runs,
    summarise_modes,
    write_comparison,
    write_json,
    write_metrics,
    write_parquet,
)
from diffstack_mmv.reporting.metrics_table import MODE_SCORES

SITUATIONS = ["moving", "standing"]


def samples(seed=0, shift=0.0):
    rng = np.random.default_rng(seed)
    count = 60
    frame = pd.DataFrame({name: rng.random(count) + shift for name in MODE_SCORES})
    frame["mode"] = np.where(np.arange(count) % 3 == 0, "scooter", "bicycle")
    frame["scene"] = [f"scene_{i // 4}" for i in range(count)]
    frame["moving"] = np.arange(count) % 2 == 0
    frame["standing"] = False
    frame["stand_still/ade"], frame["stand_still/fde"] = 2.0, 4.0
    return frame


def write_run(folder, dynamics, seed, shift=0.0):
    frame = samples(seed, shift)
    header = {"goal": "predicted", "dynamics": dynamics, "vehicle": "bicycle", "data": "thab_vru"}
    metrics = header | {"split": "test", "seed": seed} | summarise_modes(frame, SITUATIONS)
    write_metrics(folder, metrics)
    write_parquet(folder / "samples.parquet", frame)
    return folder


def test_metrics_have_the_keys_that_users_rely_on(tmp_path):
    write_run(tmp_path, "kbm", 0)
    metrics = read_json(tmp_path / "metrics.json")
    assert set(metrics["modes"]) == {"bicycle", "scooter"}
    assert set(metrics["modes"]["bicycle"]) == {"n", *MODE_SCORES}
    assert metrics["modes"]["bicycle"]["n"] == 40
    assert metrics["baselines"]["stand_still"]["scooter"] == {"ade": 2.0, "fde": 4.0}


def test_means_are_those_of_the_samples(tmp_path):
    frame = samples()
    metrics = summarise_modes(frame, SITUATIONS)
    bicycles = frame[frame["mode"] == "bicycle"]
    assert metrics["modes"]["bicycle"]["plan_ade"] == pytest.approx(bicycles["plan_ade"].mean())
    moving = metrics["situations"]["bicycle"]["moving"]
    assert moving["ade"] == pytest.approx(bicycles[bicycles["moving"]]["ade"].mean())
    assert "standing" not in metrics["situations"]["bicycle"]


def test_markdown_says_where_the_goal_came_from_and_shows_the_baselines(tmp_path):
    write_run(tmp_path, "kbm", 0)
    text = (tmp_path / "metrics.md").read_text()
    assert "no future used" in text
    assert "stand_still" in text


def test_comparison_averages_over_seeds_and_tests_pairs(tmp_path):
    runs = [write_run(tmp_path / f"kbm{seed}", "kbm", seed) for seed in (0, 1)]
    runs += [write_run(tmp_path / f"uni{seed}", "unicycle", seed, shift=0.5) for seed in (0, 1)]
    table = compare(read_runs(runs))
    row = table[(table["dynamics"] == "kbm") & (table["mode"] == "bicycle")].iloc[0]
    assert row["seeds"] == 2
    assert "±" in row["plan ADE [m]"]
    tests = paired_tests(runs)
    assert (tests["mean plan_ade"] < -0.4).all()
    assert (tests["p"] < 0.01).all()
    write_comparison(tmp_path / "out", table, tests)
    assert (tmp_path / "out" / "table.tex").read_text().startswith(r"\begin{tabular}")


def test_not_a_number_is_refused_and_the_old_file_stays(tmp_path):
    path = tmp_path / "metrics.json"
    write_json(path, {"a": 1})
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(path, {"a": float("nan")})
    assert json.loads(path.read_text()) == {"a": 1}


@pytest.mark.parametrize(
    ("content", "told"), [(None, "no such file"), ("{", "must be JSON"), ("[]", "JSON object")]
)
def test_unreadable_results_are_told_with_their_file(tmp_path, content, told):
    path = tmp_path / "metrics.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ValueError, match=told):
        read_json(path)


def test_comparing_nothing_is_refused():
    with pytest.raises(ValueError, match="`runs` must name at least one folder"):
        read_runs([])
