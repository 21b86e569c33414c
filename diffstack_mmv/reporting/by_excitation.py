"""Scores of the models against how hard the human rode: where one vehicle model beats another."""

import logging
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import pandas as pd

from diffstack_mmv.reporting.bootstrapping import bootstrap
from diffstack_mmv.reporting.compared_runs import (
    RECORDING,
    SAMPLE,
    SETTING,
    identity,
    with_recordings,
)
from diffstack_mmv.reporting.files import read_json, read_parquet, told_as_broken, write_text
from diffstack_mmv.reporting.table import markdown_table

logger = logging.getLogger(__name__)


@runtime_checkable
class Quantity(Protocol):
    """What a table of reports has in a column of that name, with its title and ranges."""

    @property
    def name(self) -> str:
        """Column."""
        ...

    @property
    def heading(self) -> str:
        """Title with the unit."""
        ...

    @property
    def edges(self) -> tuple[float, ...]:
        """Ends of the ranges, ascending."""
        ...


class PairedSamples(NamedTuple):
    """Samples that all models judged.

    Attributes:
        table: One row per sample of each setting (`SETTING`), one column per model: its score, mean
            over seeds, NaN for a model that was not judged in that setting.
        models: Names of these columns.
        quantities: How hard the human rode.
    """

    table: pd.DataFrame
    models: list[str]
    quantities: Sequence[Quantity]

    def by_setting(self) -> dict[str, pd.DataFrame]:
        """Rows of each setting, by what it is called."""
        if self.table.empty:
            return {}
        return {", ".join(map(str, key)): part for key, part in self.table.groupby(SETTING)}


def paired_samples(
    folders: Sequence[Path],
    score: str,
    quantities: Sequence[Quantity],
    sets: Sequence[str] | None = None,
) -> PairedSamples:
    """Scores of the same samples by several models.

    Samples that a model of their setting could not judge are left out for all of them. Reports of
    before there was an excitation are left out too, and named in the log.

    Args:
        folders: Reports.
        score: Name of the score.
        quantities: How hard the human rode.
        sets: What the data of each report are called; by default as in its `metrics.json`, where
            two sets of one kind have one name.
    """
    names, parts = [each.name for each in quantities], []
    for index, folder in enumerate(folders):
        metrics = read_json(folder / "metrics.json")
        with told_as_broken(folder / "samples.parquet"):
            whole = read_parquet(folder / "samples.parquet")
            if not set(names) <= set(whole):
                logger.warning("%s has no excitation: evaluate it again for that table.", folder)
                continue
            part = whole[[*identity(whole), score, *names]]
        vehicles = [metrics["modes"][mode]["vehicle"] for mode in part["mode"]]
        place = {key: metrics[key] for key in ("data", "split", "goal", "dynamics")}
        place |= {} if sets is None else {"data": sets[index]}
        parts.append(part.assign(vehicle=vehicles, **place))
    if not parts:
        return PairedSamples(pd.DataFrame(), [], quantities)
    joined = with_recordings(pd.concat(parts, ignore_index=True), ["data"])
    # the same sample has the same excitation up to rounding in every run: that of the first counts
    first = joined.groupby([*SETTING, *SAMPLE])[names].transform("first")
    joined[names] = first.round(3)
    keys = [*SETTING, *SAMPLE, RECORDING, *names, "dynamics"]
    wide = joined.groupby(keys)[score].mean().unstack()
    models = [str(name) for name in wide.columns]
    whole = [
        part[part[_present(part, models)].notna().all(axis=1)]
        for _, part in wide.groupby(level=SETTING)
    ]
    return PairedSamples(pd.concat(whole).reset_index(), models, quantities)


def _present(part: pd.DataFrame, models: Sequence[str]) -> list[str]:
    """Models that judged anything of a part."""
    return [model for model in models if part[model].notna().any()]


def by_excitation(paired: PairedSamples, resamples: int = 1000) -> pd.DataFrame:
    """Paired differences of all models by the lateral acceleration and the speed of the human.

    Args:
        paired: What is compared.
        resamples: Draws of the bootstrap over recordings.

    Returns:
        One row per setting, range and pair: number of samples and recordings, the mean of both, the
        mean difference with its interval of 95 % where there are recordings enough. No row where
        there are no two models.
    """
    if len(paired.models) < 2:
        return pd.DataFrame()
    rows = []
    for place, group in paired.table.groupby(SETTING):
        for quantity in paired.quantities:
            ranges = pd.cut(group[quantity.name], list(quantity.edges), right=False)
            for span, part in group.groupby(ranges, observed=True):
                where = dict(zip(SETTING, place, strict=True))
                where |= {"by": quantity.heading, "range": f"{span.left:g} to {span.right:g}"}
                pairs = combinations(_present(group, paired.models), 2)
                rows += [where | _pair(part, *pair, resamples) for pair in pairs]
    return pd.DataFrame(rows)


def _pair(part: pd.DataFrame, first: str, second: str, resamples: int) -> dict[str, object]:
    difference = part[first] - part[second]
    low, high = bootstrap(difference, part[RECORDING], resamples)
    return {
        "pair": f"{first} - {second}",
        "n": len(part),
        "recordings": part[RECORDING].nunique(),
        "first": part[first].mean(),
        "second": part[second].mean(),
        "Δ": difference.mean(),
        "low": low,
        "high": high,
    }


def write_by_excitation(folder: Path, paired: PairedSamples) -> None:
    """Write `excitation.md` and `.csv`; nothing where no two models can be compared."""
    table = by_excitation(paired)
    if table.empty:
        return
    write_text(folder / "excitation.md", f"{markdown_table(table, '.4f')}\n")
    write_text(folder / "excitation.csv", str(table.to_csv(index=False)))
