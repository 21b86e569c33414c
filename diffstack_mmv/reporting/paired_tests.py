"""Whether two dynamics differ by more than chance: a test of their scores, paired by recording."""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.stats import wilcoxon

from diffstack_mmv.reporting.compared_runs import (
    RECORDING,
    SAMPLE,
    SETTING,
    identity,
    with_recordings,
)
from diffstack_mmv.reporting.files import read_json, read_parquet, told_as_broken
from diffstack_mmv.reporting.scores import ScoreHeading
from diffstack_mmv.reporting.table import NONE, known_mean


def require_score(folders: Sequence[Path], score: str) -> None:
    """Refuse a score for the paired test that a report does not have.

    Raises:
        ValueError: It is one of plans, and a report was made without them, or of no report at all.
    """
    for folder in folders:
        for mode, told in read_json(folder / "metrics.json").get("modes", {}).items():
            if score not in told:
                raise ValueError(
                    f"`score` must be a score of every report, but got no {score} of {mode} in "
                    f"{folder}. Give score=ade, or evaluate it with plans=true."
                )


def paired_tests(folders: Sequence[Path], score: ScoreHeading) -> pd.DataFrame:
    """Wilcoxon signed-rank test between the dynamics, paired by recording.

    Windows of one recording resemble each other, so the score is averaged over those that both
    judged, and over seeds, before the test. The table says which of both has the better mean, and
    beside each p value the one corrected for the number of its tests, see `holm`.
    """
    samples = []
    for folder in folders:
        metrics = read_json(folder / "metrics.json")
        with told_as_broken(folder / "samples.parquet"):
            whole = read_parquet(folder / "samples.parquet")
            frame = whole[[*identity(whole), score.name]]
        vehicles = [metrics["modes"][mode]["vehicle"] for mode in frame["mode"]]
        place = {key: metrics[key] for key in ("data", "split", "goal", "dynamics")}
        samples.append(frame.assign(vehicle=vehicles, **place))
    joined = with_recordings(pd.concat(samples, ignore_index=True), ["data"])
    keys = [*SETTING, *SAMPLE, RECORDING, "dynamics"]
    windows = joined.groupby(keys)[score.name].mean().unstack()
    rows = []
    for place, group in windows.groupby(level=SETTING):
        for first, second in combinations(group.columns, 2):
            both = (group[first] - group[second]).dropna()
            difference = both.groupby(level=RECORDING).mean().to_numpy()
            row = dict(zip(SETTING, place, strict=True))
            row["pair"] = f"{first} - {second}"
            mean = known_mean(difference)
            row |= {"recordings": len(difference), f"mean Δ {score.heading}": mean}
            row["better"] = _better(first, second, mean, score.lower_is_better)
            rows.append(row | {"p": signed_rank(difference)})
    table = pd.DataFrame(rows)
    return table if table.empty else table.assign(**{"p (Holm)": holm(table["p"].to_numpy())})


def _better(first: str, second: str, difference: float, lower_is_better: bool) -> str:
    """Which of both a mean difference, first minus second, speaks for; a dash for neither."""
    if np.isnan(difference) or round(difference, 6) == 0:
        return NONE
    return first if (difference < 0) == lower_is_better else second


def signed_rank(difference: Float[np.ndarray, " n"]) -> float:
    """Two-sided p value of the Wilcoxon signed-rank test of differences.

    NaN below six unequal pairs; what differs by less than a millionth is equal.
    """
    told = np.round(difference, 6)
    if (told != 0).sum() < 6:
        return float("nan")
    result: Any = wilcoxon(told)
    return float(result.pvalue)


def holm(p: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """P values corrected for their number, those of n tests that belong together.

    Below a level where chance alone would bring any of the n there at most as often as that. NaN
    where there was no test, which does not count.

    Source:
        Holm, A simple sequentially rejective multiple test procedure (1979).
    """
    order = np.argsort(p, kind="stable")  # NaN comes last
    least_first = p[order] * (np.count_nonzero(~np.isnan(p)) - np.arange(len(p)))
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(np.maximum.accumulate(least_first), 1)
    return corrected
