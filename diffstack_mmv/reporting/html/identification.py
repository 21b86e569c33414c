"""Parameters, models and remarks of an identification."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from diffstack_mmv.reporting.files import read_json
from diffstack_mmv.reporting.html.blocks import (
    Block,
    Chart,
    Note,
    Section,
    Table,
    facts,
    frame_table,
)
from diffstack_mmv.reporting.identification import models_table
from diffstack_mmv.reporting.table import cell

SHOWN = ("initial", "estimate", "std", "low", "high", "unit", "identifiability", "verdict")


def read_identification(folder: Path) -> list[Section]:
    """What `identify` wrote; nothing without `identification.json`."""
    if not (folder / "identification.json").is_file():
        return []
    result = read_json(folder / "identification.json")
    blocks: list[Block] = [facts("Setting", result)]
    # models of measured controls have more than errors: they stand in models.csv, a table by itself
    if result.get("models") and result.get("controls") != "measured":
        blocks.append(frame_table("Tracking errors [m]", models_table(result["models"]), digits=4))
    for name in ("parameters", "combinations"):
        if result.get(name):
            blocks.append(_estimates(name.capitalize(), result[name]))
    blocks += [Note(remark) for remark in result.get("remarks", ())]
    return [Section("Identification", [*blocks, *_profiles(result), *_influence(result)])]


def _estimates(title: str, entries: Mapping[str, Mapping[str, Any]]) -> Table:
    rows = [
        [name, *(cell(entry.get(key), ".4g") for key in SHOWN)] for name, entry in entries.items()
    ]
    return Table(title, ["", *SHOWN], rows)


def _profiles(result: Mapping[str, Any]) -> list[Block]:
    """Least cost over each fixed value of a parameter, above the least of all."""
    charts: list[Block] = []
    for name, told in (result.get("profiles") or {}).items():
        least = min(told["costs"])
        above = [cost - least for cost in told["costs"]]
        lines = {name: (told["values"], above)}
        charts.append(Chart(f"Profile: {name}", name, "cost above the least", lines, marks=True))
    return charts


def _influence(result: Mapping[str, Any]) -> list[Block]:
    told = result.get("regularisation_influence")
    if not told:
        return []
    title = "Influence of the regularisation, in prior deviations"
    return [frame_table(title, pd.DataFrame(told), index=True, digits=2)]
