"""Paired tests between closed-loop runs over the same cases."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from diffstack_mmv.reporting.files import read_json, told_as_broken
from diffstack_mmv.reporting.paired_tests import signed_rank
from diffstack_mmv.reporting.scores import Scores
from diffstack_mmv.reporting.table import cell

CASES = ("scenario", "data", "humans", "phase", "drawn_by", "recordings")
"""By what the number of a case is a case; `data` and `recordings` of recorded people alone."""
LATER = ("drawn_by", "recordings")
"""Entries that headers of earlier versions do not have."""
SETTINGS = (*CASES, "limit_s", "dt_s", "verdict")
"""What two runs have to share to be compared case by case."""
OUTCOMES = {"success": "success_rate", "collision": "collision_rate"}
SHIFTS = {"time_s": "nav_time_s", "discomfort": "discomfort_frequency"}
"""Tested numbers of a case, each with the score that it is a part of."""


def paired_with_run(result: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Compare a run case by case with an earlier one.

    Args:
        result: Header and cases of the run.
        folder: Folder with the `closed_loop.json` of the earlier one.

    Returns:
        See `paired_cases`; `other` names the earlier run and its folder.

    Raises:
        ValueError: The file is missing, has no case in common with the run, or was made under
            other settings.
    """
    with told_as_broken(folder / "closed_loop.json"):
        return _paired_with(result, read_json(folder / "closed_loop.json"), folder)


def _paired_with(
    result: Mapping[str, Any], other: Mapping[str, Any], folder: Path
) -> dict[str, Any]:
    require_same(SETTINGS, result, other, "against", folder)
    name = f"{other['controller']} ({other['dynamics']} {other['vehicle']})"
    if other["believed_dynamics"] != other["dynamics"]:
        name += f", believes in {other['believed_dynamics']}"
    return {"other": f"{name} in {folder}"} | paired_cases(result["cases"], other["cases"])


def require_comparable(header: Mapping[str, Any], cases: Collection[int], folder: Path) -> None:
    """Refuse an earlier run that `paired_with_run` would refuse, before anything is driven.

    Args:
        header: Of the run.
        cases: Numbers that it will drive.
        folder: Folder with the `closed_loop.json` of the earlier one.

    Raises:
        ValueError: As `paired_with_run`.
    """
    with told_as_broken(folder / "closed_loop.json"):
        other = read_json(folder / "closed_loop.json")
        require_same(SETTINGS, header, other, "against", folder)
        if not any(case["case"] in cases for case in other["cases"]):
            raise ValueError(
                f"`against` must share cases with the run, but got none in {folder}. Drive the "
                "same."
            )


def require_same(
    names: Sequence[str],
    result: Mapping[str, Any],
    other: Mapping[str, Any],
    argument: str,
    folder: Path,
) -> None:
    """Refuse another run under other settings.

    Args:
        names: Of the settings, entries of the header.
        result: Header of a run.
        other: That of the other one.
        argument: What names the other one.
        folder: Where it lies.

    Raises:
        ValueError: A setting differs.
    """
    for name in names:
        known = name not in LATER or (name in result and name in other)
        if known and other.get(name) != result.get(name):
            raise ValueError(
                f"`{argument}` must name runs with {name} {result.get(name)}, but got "
                f"{other.get(name)} in {folder}. Compare runs of one setting."
            )


def paired_cases(
    own: Sequence[Mapping[str, Any]], other: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Tests on the cases that both runs hold.

    Success and collision: McNemar's exact test on the cases where one of both has it. Time in s:
    Wilcoxon's signed-rank test on the cases where both succeed. Discomfort, the share of uneasy
    steps: the same test on all cases. All tests are two-sided; differences are own minus other.

    Args:
        own: Cases of a run, as in its file.
        other: Cases of another one.

    Returns:
        A dictionary for JSON; p is None where too few pairs differ (below six for Wilcoxon).

    Raises:
        ValueError: The runs have no case in common.

    Source:
        McNemar, Note on the sampling error of the difference between correlated proportions (1947);
        Wilcoxon, Individual comparisons by ranking methods (1945).
    """
    pairs = pd.DataFrame(own).merge(pd.DataFrame(other), on="case", suffixes=("", "_other"))
    if pairs.empty:
        raise ValueError("`other` must share cases with the run, but got none. Drive the same.")
    both = pairs[(pairs["outcome"] == "success") & (pairs["outcome_other"] == "success")]
    share = pairs["discomfort_steps"] / pairs["steps"]
    share_other = pairs["discomfort_steps_other"] / pairs["steps_other"]
    return {
        "n": len(pairs),
        "success": _discordant(pairs, "success"),
        "collision": _discordant(pairs, "collision"),
        "time_s": _shift(both["time_s"] - both["time_s_other"]),
        "discomfort": _shift(share - share_other),
    }


def paired_table(pairs: Sequence[Mapping[str, Any]], scores: Scores) -> pd.DataFrame:
    """One row per comparison: counts of discordant cases, mean differences and p values."""
    rows = []
    for pair in pairs:
        row = {"against": pair["other"], "n": pair["n"]}
        for name, score in OUTCOMES.items():
            test, title = pair[name], scores[score].title
            row[f"{title} only here / there"] = f"{test['only_own']} / {test['only_other']}"
            row[f"p ({title})"] = cell(test["p"], ".3g")
        for name, score in SHIFTS.items():
            heading = scores[score].heading
            row[f"Δ {heading}"] = cell(pair[name]["mean"], "+.4f")
            row[f"p ({heading})"] = cell(pair[name]["p"], ".3g")
        rows.append(row)
    return pd.DataFrame(rows)


def _discordant(pairs: pd.DataFrame, outcome: str) -> dict[str, Any]:
    """McNemar's exact test of one outcome."""
    own, other = pairs["outcome"] == outcome, pairs["outcome_other"] == outcome
    only_own, only_other = int((own & ~other).sum()), int((other & ~own).sum())
    total = only_own + only_other
    p = float(binomtest(only_own, total).pvalue) if total else None
    return {"only_own": only_own, "only_other": only_other, "p": p}


def _shift(difference: pd.Series) -> dict[str, Any]:
    """Mean difference and the p value of the signed-rank test."""
    values = difference.to_numpy(np.float64)
    p = signed_rank(values)
    return {
        "pairs": len(values),
        "mean": float(values.mean()) if len(values) else None,
        "p": None if np.isnan(p) else p,
    }
