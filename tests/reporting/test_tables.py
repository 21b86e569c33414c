"""Result files: the contract's keys, atomic writing, comparison over runs."""

import json

import numpy as np
import pytest

from diffstack_mmv.metrics import OPEN_LOOP
from diffstack_mmv.metrics.scores import OF_THE_PREDICTION
from diffstack_mmv.reporting import (
    compare,
    paired_tests,
    read_json,
    read_runs,
    summarise_modes,
    write_comparison,
    write_json,
)
from diffstack_mmv.reporting.metrics_table import mode_table, situation_table
from diffstack_mmv.reporting.paired_tests import require_score
from tests.reporting.runs import SITUATIONS, samples, write_run


def test_metrics_have_the_keys_that_users_rely_on(tmp_path):
    write_run(tmp_path, "kbm", 0)
    metrics = read_json(tmp_path / "metrics.json")
    assert set(metrics["modes"]) == {"bicycle", "scooter"}
    bicycles = metrics["modes"]["bicycle"]
    assert set(bicycles) == {"n", "n_missing", "vehicle", *OPEN_LOOP}
    assert (bicycles["n"], bicycles["n_missing"], bicycles["vehicle"]) == (40, 0, "bicycle")
    assert metrics["baselines"]["stand_still"]["scooter"] == {"ade": 2.0, "fde": 4.0}


def test_who_is_driven_with_the_vehicle_of_another_mode_is_told_above_the_scores(tmp_path):
    told = "Agents of mode scooter are driven with the vehicle bicycle."
    write_run(tmp_path, "kbm", 0, modes_of_other_vehicles=["motorcycle", "scooter"])
    assert told in (tmp_path / "metrics.md").read_text().partition("## ")[0]
    for more in ({}, {"modes_of_other_vehicles": []}):
        write_run(tmp_path, "kbm", 0, **more)
        assert "are driven with" not in (tmp_path / "metrics.md").read_text()


def test_costs_are_told_by_term(tmp_path):
    frame = samples().assign(**{"cost/goal": 2.0, "cost/collision": 0.5})
    write_run(tmp_path, "kbm", 0, frame=frame)
    told = read_json(tmp_path / "metrics.json")["costs"]
    assert told["bicycle"] == {"goal": 2.0, "collision": 0.5}
    assert "Cost of the plan in hindsight by term" in (tmp_path / "metrics.md").read_text()


def test_means_are_those_of_the_samples(tmp_path):
    frame = samples()
    metrics = summarise_modes(frame, SITUATIONS, "bicycle", OPEN_LOOP)
    bicycles = frame[frame["mode"] == "bicycle"]
    assert metrics["modes"]["bicycle"]["plan_ade"] == pytest.approx(bicycles["plan_ade"].mean())
    moving = metrics["situations"]["bicycle"]["moving"]
    assert moving["ade"] == pytest.approx(bicycles[bicycles["moving"]]["ade"].mean())
    assert "standing" not in metrics["situations"]["bicycle"]


def test_samples_that_cannot_be_judged_are_counted_and_not_averaged(tmp_path):
    frame = samples()
    bicycles = frame.index[frame["mode"] == "bicycle"]
    frame.loc[bicycles[:3], ["ade", "fde"]] = np.nan
    frame.loc[bicycles[2:5], "plan_fde"] = np.nan
    write_run(tmp_path, "kbm", 0, frame=frame)
    metrics = read_json(tmp_path / "metrics.json")
    told = metrics["modes"]["bicycle"]
    assert (told["n"], told["n_missing"]) == (40, 5)
    assert told["ade"] == pytest.approx(frame.loc[bicycles[3:], "ade"].mean())
    assert metrics["modes"]["scooter"]["n_missing"] == 0
    assert list(mode_table(metrics, OPEN_LOOP)["not judged"]) == ["5", "0"]
    assert "not judged" in (tmp_path / "metrics.md").read_text()


def test_tables_say_nothing_of_missing_samples_where_none_is_missing(tmp_path):
    write_run(tmp_path, "kbm", 0)
    assert "not judged" not in (tmp_path / "metrics.md").read_text()


def test_a_score_that_judged_no_sample_is_null_and_a_dash(tmp_path):
    frame = samples()
    frame.loc[frame["mode"] == "scooter", ["ade", "stand_still/ade"]] = np.nan
    run = write_run(tmp_path, "kbm", 0, frame=frame)
    metrics = read_json(tmp_path / "metrics.json")
    assert metrics["modes"]["scooter"]["ade"] is None
    assert metrics["baselines"]["stand_still"]["scooter"]["ade"] is None
    assert "| –" in (tmp_path / "metrics.md").read_text()
    table = compare(read_runs([run]), OPEN_LOOP).table
    assert set(table.loc[table["mode"] == "scooter", "ADE [m]"]) == {"–"}


def test_situations_tell_the_errors_of_their_own_samples(tmp_path):
    frame = samples()
    metrics = read_json(write_run(tmp_path, "kbm", 0, frame=frame) / "metrics.json")
    row = situation_table(metrics).set_index("mode").loc["scooter"]
    moving = frame[(frame["mode"] == "scooter") & frame["moving"]]
    assert (row["situation"], row["n"], row["stand still"]) == ("moving", len(moving), 2.0)
    assert row["prediction (median)"] == pytest.approx(moving["median_ade"].mean())
    assert row["plan"] == pytest.approx(moving["plan_ade"].mean())
    del metrics["situations"]["scooter"]["moving"]["plan_ade"]  # as without plans
    assert np.isnan(situation_table(metrics).set_index("mode").loc["scooter", "plan"])


def test_markdown_says_where_the_goal_came_from_and_shows_the_baselines(tmp_path):
    write_run(tmp_path, "kbm", 0)
    text = (tmp_path / "metrics.md").read_text()
    assert "no future used" in text
    assert "stand still" in text


@pytest.fixture
def runs(tmp_path):
    """Two seeds of the kinematic model, and of a worse one."""
    return [
        write_run(tmp_path / f"{name}{seed}", name, seed, shift=shift)
        for name, shift in (("kbm", 0.0), ("unicycle", 0.5))
        for seed in (0, 1)
    ]


def test_comparison_averages_over_seeds(runs):
    table = compare(read_runs(runs), OPEN_LOOP).table
    row = table[(table["dynamics"] == "kbm") & (table["mode"] == "bicycle")].iloc[0]
    assert row["seeds"] == 2
    assert "±" in row["plan ADE [m]"]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"frame": samples().iloc[::2]}, "the same windows for .*bicycle, but got 40 in .* and 20"),
        ({"smoother": "ZeroPhaseSmoother"}, "the same smoother for .*ZeroPhaseSmoother"),
    ],
    ids=["fewer", "smoothed otherwise"],
)
def test_runs_that_judged_other_windows_are_refused(tmp_path, given, told):
    """The one with the easier windows would be the best in bold."""
    whole = write_run(tmp_path / "whole", "kbm", 0)
    other = write_run(tmp_path / "other", "unicycle", 0, **given)
    with pytest.raises(ValueError, match=told):
        read_runs([whole, other])


def test_planning_losses_of_other_weights_are_not_compared(tmp_path):
    folders = [
        write_run(tmp_path / name, name, 0, hindsight=weight)
        for name, weight in (("kbm", 0.01), ("gm3", 0.0))
    ]
    with pytest.raises(ValueError, match="must have the same hindsight .* 0.01 in .* and 0.0 in"):
        read_runs(folders)


def test_plans_to_a_goal_by_another_way_are_not_compared(tmp_path):
    """Nor pooled as seeds of one row."""
    folders = [
        write_run(tmp_path / str(share), "kbm", seed, goal="future", steadiness=share)
        for seed, share in enumerate((0.15, 0.0))
    ]
    told = "the same steadiness for .*, future, bicycle, but got 0.15 in .* and 0.0 in"
    with pytest.raises(ValueError, match=f"{told}.*goal.steadiness"):
        read_runs(folders)


def test_reports_of_before_the_steadiness_was_told_are_compared_with_their_like(tmp_path):
    before = [write_run(tmp_path / str(seed), "kbm", seed, goal="future") for seed in (0, 1)]
    table = compare(read_runs(before), OPEN_LOOP).table.set_index(["mode", "dynamics"])
    assert table["seeds"]["bicycle", "kbm"] == 2
    now = write_run(tmp_path / "now", "gm3", 0, goal="future", steadiness=0.15)
    with pytest.raises(ValueError, match="same steadiness .* but got none told in .* and 0.15 in"):
        read_runs([*before, now])


def test_only_windows_that_both_judged_are_paired(tmp_path):
    """What a model could not judge must not count for the other."""
    hard = samples()
    easy = samples().assign(plan_ade=hard["plan_ade"] + 0.1)
    hard.loc[::2, "plan_ade"] += 10
    easy.loc[::2, "plan_ade"] = np.nan
    runs = [
        write_run(tmp_path / name, name, 0, frame=frame)
        for name, frame in (("kbm", hard), ("unicycle", easy))
    ]
    table = paired_tests(runs, OPEN_LOOP["plan_ade"])
    assert table["mean Δ plan ADE [m]"].to_numpy() == pytest.approx(-0.1)


def test_runs_of_different_vehicles_are_never_averaged(tmp_path):
    names = ("bicycle", "scooter")
    folders = [write_run(tmp_path / name, "kbm", 0, vehicle=name) for name in names]
    table = compare(read_runs(folders), OPEN_LOOP).table
    own = table[(table["dynamics"] == "kbm") & (table["mode"] == "bicycle")]
    assert sorted(own["vehicle"]) == ["bicycle", "scooter"]
    assert set(own["seeds"]) == {1}


def test_two_runs_of_one_seed_are_refused_and_what_was_not_judged_is_told(tmp_path):
    frame = samples()
    frame.loc[:4, "plan_ade"] = np.nan
    run = write_run(tmp_path / "a", "kbm", 0, frame=frame)
    table = compare(read_runs([run]), OPEN_LOOP).table
    assert table.set_index(["dynamics", "mode"])["not judged"]["kbm", "bicycle"] == 3
    with pytest.raises(ValueError, match="`runs` must differ in seed"):
        read_runs([run, write_run(tmp_path / "b", "kbm", 0)])


@pytest.mark.parametrize(("score", "better"), [("plan_ade", "kbm"), ("solved", "unicycle")])
def test_paired_tests_say_which_sign_is_better(runs, score, better):
    tests = paired_tests(runs, OPEN_LOOP[score])
    assert (tests[f"mean Δ {OPEN_LOOP[score].heading}"] < -0.4).all()
    assert (tests["p"] < 0.01).all()
    assert set(tests["better"]) == {better}


def test_splits_are_tested_apart(tmp_path):
    folders = [
        write_run(tmp_path / f"{name}_{split}", name, 0, shift=shift * sign, split=split)
        for split, sign in (("test", 1), ("val", -1))
        for name, shift in (("kbm", 0.0), ("gm3", 0.05))
    ]
    tests = paired_tests(folders, OPEN_LOOP["plan_ade"])
    bicycles = tests[tests["mode"] == "bicycle"].set_index("split")
    assert bicycles["better"].to_dict() == {"test": "kbm", "val": "gm3"}


def test_a_path_that_is_given_the_goal_is_no_prediction(tmp_path):
    frame = samples()
    frame["stand_still/nll"] = 1.0
    frame["spline/ade"], frame["spline/fde"] = 0.01, 0.0
    folders = [
        write_run(tmp_path / goal, "kbm", 0, frame=frame, goal=goal)
        for goal in ("predicted", "future")
    ]
    table = compare(read_runs(folders), OPEN_LOOP).table.set_index(["goal", "mode", "dynamics"])
    spline = table.loc[("future", "bicycle", "spline")]
    assert (spline["ADE [m]"], spline["plan ADE [m]"]) == ("–", "0.010")
    still = table.loc[("future", "bicycle", "stand_still")]
    assert still["ADE [m]"] == still["plan ADE [m]"] == "2.000"


def test_pairs_too_few_to_test_have_a_dash_for_p(runs, tmp_path):
    comparison = compare(read_runs(runs), OPEN_LOOP)
    tests = paired_tests(runs, OPEN_LOOP["plan_ade"]).assign(**{"p (Holm)": [0.01, np.nan]})
    write_comparison(tmp_path, comparison, tests)
    lines = (tmp_path / "table.md").read_text().splitlines()
    assert lines[-1].replace(" ", "").endswith("|–|")
    assert lines[-2].replace(" ", "").endswith("|0.01|")
    assert "nan" not in "".join(lines)


@pytest.mark.parametrize(
    ("heading", "best"),
    [("ADE [m]", "kbm"), ("plan ADE [m]", "kbm"), ("collisions", "kbm"), ("solved", "unicycle")],
)
def test_best_of_a_setting_is_found_by_the_direction_of_the_score(runs, heading, best):
    comparison = compare(read_runs(runs), OPEN_LOOP)
    assert comparison.best.index.equals(comparison.table.index)
    assert set(comparison.table.loc[comparison.best[heading], "dynamics"]) == {best}
    assert comparison.best[heading].sum() == 2


def test_equals_are_all_best_and_one_alone_is_not(tmp_path):
    alone = compare(read_runs([write_run(tmp_path / "one", "kbm", 0)]), OPEN_LOOP)
    assert not alone.best["solved"].any()
    twice = [write_run(tmp_path / name, name, 0) for name in ("kbm", "gm3")]
    both = compare(read_runs(twice), OPEN_LOOP)
    assert both.best.loc[both.table["dynamics"] != "stand_still", "solved"].all()


@pytest.mark.parametrize(("other", "ties"), [(0.012, False), (0.013, True)])
def test_what_is_best_goes_by_the_numbers_that_the_table_shows(tmp_path, other, ties):
    """0.0125 is shown as 0.013, but was taken for 0.012."""
    told = read_runs([write_run(tmp_path / name, name, 0) for name in ("kbm", "gm3")])
    told["collision_rate"] = told["dynamics"].map({"kbm": 0.0125, "gm3": other})
    comparison = compare(told, OPEN_LOOP)
    best = comparison.table.loc[comparison.best["collisions"]]
    assert set(best["dynamics"]) == ({"kbm", "gm3"} if ties else {"gm3"})
    assert best["collisions"].nunique() == 1


def test_best_is_bold_in_markdown_and_latex_but_not_in_csv(runs, tmp_path):
    comparison = compare(read_runs(runs), OPEN_LOOP)
    write_comparison(tmp_path / "out", comparison, paired_tests(runs, OPEN_LOOP["ade"]))
    texts = [(tmp_path / "out" / f"table.{ending}").read_text() for ending in ("md", "tex", "csv")]
    for text, mark in zip(texts, ("**{}**", r"\textbf{{{}}}"), strict=False):
        for heading, best in comparison.best.items():
            assert all(mark.format(cell) in text for cell in comparison.table.loc[best, heading])
        assert text.count(mark.split("{")[0]) in (14, 28)  # two modes, seven scores
    assert texts[1].startswith(r"\begin{tabular}")
    assert "*" not in texts[2]


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


def test_reports_without_plans_are_compared_by_their_predictions(tmp_path):
    folders = [tmp_path / "kbm", tmp_path / "gm3"]
    for folder in folders:
        path = write_run(folder, folder.name, 0) / "metrics.json"
        told = json.loads(path.read_text())
        for scores in told["modes"].values():
            for name in set(OPEN_LOOP) - set(OF_THE_PREDICTION):
                scores.pop(name, None)
        path.write_text(json.dumps(told))
    table = compare(read_runs(folders), OPEN_LOOP).table
    assert OPEN_LOOP["ade"].heading in table
    assert OPEN_LOOP["plan_ade"].heading not in table
    require_score(folders, "ade")
    with pytest.raises(ValueError, match="`score` must be a score of every report"):
        require_score(folders, "plan_ade")


def test_comparing_nothing_is_refused():
    with pytest.raises(ValueError, match="`runs` must name at least one folder"):
        read_runs([])
