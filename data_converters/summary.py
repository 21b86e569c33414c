"""A conversion in a few lines, to read in a terminal; all numbers are in the report's file."""

import pandas as pd

from data_converters.report import ConversionReport
from dmmv_conventions.cache import SPLITS


def summary(report: ConversionReport) -> str:
    """What a conversion read, kept and rejected, as text with a Markdown table of the agents."""
    totals = report.totals()
    told = [
        f"Scenes with agents: {totals['scenes']:,}, from {totals['tracks_read']:,} tracks; "
        f"{totals['rows']:,} rows, {_share(totals['interpolated_rows'], totals['rows'])} of them "
        "between recorded samples.",
    ]
    if totals["scenes_without_agents"]:
        told.append(f"Scenes without agents, left out: {totals['scenes_without_agents']:,}.")
    for title, counts in (("Rejected", totals["rejected"]), ("Notes", totals["notes"])):
        named = [f"{name} {number:,}" for name, number in counts.items() if number]
        told += [f"{title}: {', '.join(named)}."] if named else []
    return "\n".join([*told, *_reasons(report), "", _agents(report)])


def _reasons(report: ConversionReport) -> list[str]:
    """The first rejection of each reason in full, which names the place and the remedy."""
    first: dict[str, str] = {}
    for each in (rejected for scene in report.scenes for rejected in scene.rejected):
        first.setdefault(each["reason"], each["detail"])
    return [f"{reason}, the first: {detail}" for reason, detail in first.items()]


def _share(part: int, whole: int) -> str:
    """A share in whole per cent; a dash of nothing."""
    return f"{100 * part / whole:.0f} %" if whole else "–"


def _agents(report: ConversionReport) -> str:
    """Number of agents, and of windows in brackets: one row per mode, one column per split."""
    windows = report.windows()
    cells = {
        split: {mode: f"{n:,} ({windows[split].get(mode, 0):,})" for mode, n in counts.items()}
        for split, counts in report.agents().items()
    }
    frame = pd.DataFrame({split: cells[split] for split in SPLITS if split in cells})
    frame.index.name = "agents (windows of 4 + 3 s)"
    return frame.sort_index().fillna("–").to_markdown()
