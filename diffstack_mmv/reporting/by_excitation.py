"""Scores of the models against how hard the human rode: where one vehicle model beats another."""

import logging
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from diffstack_mmv.metrics import LATERAL, SPEED
from diffstack_mmv.plotting import draw_by_excitation, save_figure
from diffstack_mmv.reporting.files import read_json, read_parquet, told_as_broken, write_text
from diffstack_mmv.reporting.paper_table import bootstrap
from diffstack_mmv.reporting.scores import ScoreHeading

logger = logging.getLogger(__name__)

EDGES = {LATERAL: (0.0, 0.5, 1.0, 2.0, 3.0, np.inf), SPEED: (0.0, 2.0, 4.0, 6.0, 8.0, np.inf)}
FEWEST_SCENES = 4  # with fewer, drawing them with replacement tells nothing of an interval
HEADINGS = {LATERAL: "lateral acceleration [m/s²]", SPEED: "speed [m/s]"}
PLACE = ["data", "goal", "mode", "vehicle"]
SAMPLE = ["scene", "agent", "row", LATERAL, SPEED]


class PairedSamples(NamedTuple):
    """Samples that all models judged.

    Attributes:
        table: One row per sample of each setting, one column per model: its score, mean over seeds.
        models: Names of these columns.
    """

    table: pd.DataFrame
    models: list[str]


def paired_samples(folders: Sequence[Path], score: str) -> PairedSamples:
    """Scores of the same samples by several models.

    Samples that a model could not judge are left out for all. Reports of before there was an
    excitation are left out too, and named in the log.
    """
    parts = []
    for folder in folders:
        metrics = read_json(folder / "metrics.json")
        with told_as_broken(folder / "samples.parquet"):
            whole = read_parquet(folder / "samples.parquet")
            if LATERAL not in whole:
                logger.warning("%s has no excitation: evaluate it again for that table.", folder)
                continue
            part = whole[["mode", score, *SAMPLE]]
        vehicles = [metrics["modes"][mode]["vehicle"] for mode in part["mode"]]
        place = {key: metrics[key] for key in ("data", "goal", "dynamics")}
        parts.append(part.assign(vehicle=vehicles, **place))
    if not parts:
        return PairedSamples(pd.DataFrame(), [])
    joined = pd.concat(parts)
    # the same sample has the same excitation up to rounding in every run
    joined[[LATERAL, SPEED]] = joined[[LATERAL, SPEED]].round(3)
    wide = joined.groupby([*PLACE, *SAMPLE, "dynamics"])[score].mean().unstack()
    return PairedSamples(wide.dropna().reset_index(), [str(name) for name in wide.columns])


def by_excitation(paired: PairedSamples, resamples: int = 1000) -> pd.DataFrame:
    """Paired differences of all models by the lateral acceleration and the speed of the human.

    Args:
        paired: What is compared.
        resamples: Draws of the bootstrap over scenes.

    Returns:
        One row per setting, range and pair: number of samples and scenes, the mean of both, the
        mean difference with its interval of 95 % where there are scenes enough. No row where there
        are no two models.
    """
    if len(paired.models) < 2:
        return pd.DataFrame()
    rows = []
    for place, group in paired.table.groupby(PLACE):
        for name, edges in EDGES.items():
            ranges = pd.cut(group[name], edges, right=False)
            for span, part in group.groupby(ranges, observed=True):
                where = dict(zip(PLACE, place, strict=True))
                where |= {"by": HEADINGS[name], "range": f"{span.left:g} to {span.right:g}"}
                pairs = combinations(paired.models, 2)
                rows += [where | _pair(part, *pair, resamples) for pair in pairs]
    return pd.DataFrame(rows)


def _pair(part: pd.DataFrame, first: str, second: str, resamples: int) -> dict[str, object]:
    difference, scenes = part[first] - part[second], part["scene"].nunique()
    known = scenes >= FEWEST_SCENES
    low, high = bootstrap(difference, part["scene"], resamples) if known else (np.nan, np.nan)
    return {
        "pair": f"{first} - {second}",
        "n": len(part),
        "scenes": scenes,
        "first": part[first].mean(),
        "second": part[second].mean(),
        "Δ": difference.mean(),
        "low": low,
        "high": high,
    }


def write_by_excitation(folder: Path, paired: PairedSamples, score: ScoreHeading) -> None:
    """Write `excitation.md`, `.csv` and `.png`; nothing where no two models can be compared."""
    table = by_excitation(paired)
    if table.empty:
        return
    write_text(folder / "excitation.md", f"{table.to_markdown(index=False, floatfmt='.4f')}\n")
    write_text(folder / "excitation.csv", str(table.to_csv(index=False)))
    figure = draw_by_excitation(paired.table, paired.models, HEADINGS, score.heading)
    save_figure(figure, folder / "excitation.png")
