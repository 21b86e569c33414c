"""Paired tests between closed-loop runs."""

import json

import numpy as np
import pytest
from scipy.stats import wilcoxon

from diffstack_mmv.metrics import CLOSED_LOOP
from diffstack_mmv.reporting import (
    paired_cases,
    paired_table,
    paired_with_run,
    require_comparable,
)


def case(number, outcome="success", time_s=3.0, uneasy=0):
    return {
        "case": number, "outcome": outcome, "time_s": time_s, "steps": 12,
        "discomfort_steps": uneasy,
    }  # fmt: skip


def cases(outcomes):
    return [case(number, outcome) for number, outcome in enumerate(outcomes)]


def test_mcnemar_counts_discordant_cases_alone():
    own = cases(["success"] * 8 + ["collision"] * 4)
    other = cases(["success"] * 2 + ["collision"] * 10)
    test = paired_cases(own, other)["success"]
    assert test == {"only_own": 6, "only_other": 0, "p": pytest.approx(2 * 0.5**6)}


def test_equal_runs_have_nothing_to_decide():
    pair = paired_cases(cases(["success"] * 8), cases(["success"] * 8))
    assert (pair["success"]["p"], pair["time_s"]["p"], pair["time_s"]["mean"]) == (None, None, 0.0)


def test_times_are_compared_where_both_succeed():
    rng = np.random.default_rng(0)
    times, slower = rng.uniform(3, 4, 20), rng.uniform(0.1, 0.5, 20)
    own = [case(k, time_s=t) for k, t in enumerate(times)]
    other = [case(k, time_s=t + s) for k, (t, s) in enumerate(zip(times, slower, strict=True))]
    other[0]["outcome"] = "collision"
    test = paired_cases(own, other)["time_s"]
    assert test["pairs"] == 19
    assert test["mean"] == pytest.approx(-slower[1:].mean())
    assert test["p"] == pytest.approx(wilcoxon(slower[1:]).pvalue)


def test_cases_are_matched_by_number():
    own = [case(3, uneasy=6), case(1)]
    other = [case(1), case(2), case(3)]
    pair = paired_cases(own, other)
    assert (pair["n"], pair["discomfort"]["mean"]) == (2, pytest.approx(0.25))


def test_discomfort_is_the_difference_of_the_shares_of_uneasy_steps():
    own, other = [case(1, uneasy=3), case(2, uneasy=6)], [case(1, uneasy=8), case(2, uneasy=1)]
    own[0]["steps"], other[0]["steps"], other[1]["steps"] = 30, 16, 4
    told = paired_cases(own, other)["discomfort"]
    assert told["mean"] == pytest.approx(((0.1 - 0.5) + (0.5 - 0.25)) / 2)
    back = paired_cases(other, own)["discomfort"]
    assert (told["pairs"], back["mean"]) == (2, pytest.approx(-told["mean"]))


def test_runs_without_common_cases_are_refused():
    with pytest.raises(ValueError, match="share cases"):
        paired_cases([case(1)], [case(2)])


HEADER = {
    "controller": "diffmpc", "dynamics": "gm3", "vehicle": "bicycle", "believed_dynamics": "kbm",
    "scenario": "circle_crossing", "humans": 5, "phase": "test", "limit_s": 10.0, "dt_s": 0.25,
    "verdict": "exact",
}  # fmt: skip


def test_an_earlier_run_is_named_with_its_belief(tmp_path):
    run = HEADER | {"cases": [case(0)]}
    (tmp_path / "closed_loop.json").write_text(json.dumps(run))
    pair = paired_with_run(run, tmp_path)
    assert pair["other"] == f"diffmpc (gm3 bicycle), believes in kbm in {tmp_path}"
    assert paired_table([pair], CLOSED_LOOP)["success only here / there"].tolist() == ["0 / 0"]


def test_an_earlier_run_that_believes_in_its_own_dynamics_is_named_without(tmp_path):
    run = HEADER | {"cases": [case(0)], "believed_dynamics": "gm3"}
    (tmp_path / "closed_loop.json").write_text(json.dumps(run))
    assert paired_with_run(run, tmp_path)["other"] == f"diffmpc (gm3 bicycle) in {tmp_path}"


def test_a_run_under_other_settings_is_not_paired(tmp_path):
    run = HEADER | {"cases": [case(0)]}
    (tmp_path / "closed_loop.json").write_text(json.dumps(run | {"limit_s": 25.0}))
    with pytest.raises(ValueError, match="limit_s"):
        paired_with_run(run, tmp_path)


@pytest.mark.parametrize("name", ["drawn_by", "recordings"])
@pytest.mark.parametrize(("before", "fits"), [({}, True), ("same", True), ("another", False)])
def test_a_run_over_cases_of_another_origin_is_not_paired(tmp_path, name, before, fits) -> None:
    earlier = HEADER | {"cases": [case(0)]} | ({name: before} if before else {})
    (tmp_path / "closed_loop.json").write_text(json.dumps(earlier))
    run = HEADER | {name: "same", "cases": [case(0)]}
    if fits:
        assert paired_with_run(run, tmp_path)["success"]["p"] is None
    else:
        with pytest.raises(ValueError, match=f"runs with {name} same, but got another in"):
            paired_with_run(run, tmp_path)


@pytest.mark.parametrize(
    ("run", "cases", "told"),
    [
        (HEADER, range(1, 4), "share cases with the run, but got none in"),
        (HEADER | {"limit_s": 25.0}, range(4, 9), "limit_s"),
        (HEADER | {"data": "dut"}, range(4, 9), "runs with data dut, but got citr in"),
    ],
    ids=["other cases", "another limit", "other data"],
)
def test_runs_to_compare_with_are_refused_before_anything_is_driven(tmp_path, run, cases, told):
    earlier = HEADER | {"cases": [case(0), case(4)], "data": "citr"}
    (tmp_path / "closed_loop.json").write_text(json.dumps(earlier))
    require_comparable(HEADER | {"data": "citr"}, range(4, 9), tmp_path)
    with pytest.raises(ValueError, match=told):
        require_comparable({"data": "citr"} | run, cases, tmp_path)
