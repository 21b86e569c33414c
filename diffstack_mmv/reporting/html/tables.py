"""Tables of comparisons and of the paper, and trajectories of open-loop runs."""

import re
from pathlib import Path

import pandas as pd

from diffstack_mmv.reporting.files import told_as_broken
from diffstack_mmv.reporting.html.blocks import Block, Chart, Section, frame_table
from diffstack_mmv.reporting.html.quantities import quantity

TABLES = {
    "table.csv": "Comparison",
    "models.csv": "Models",
    "installed.csv": "Installed",
    "recordings.csv": "Recordings",
    "rollouts.csv": "Roll-outs",
    "tests.csv": "Paired tests",
    "results.csv": "Results",
}
"""File -> title."""
LONG = re.compile(r"-?\d+\.\d{5,}(e-?\d+)?")


def read_tables(folder: Path) -> list[Section]:
    """What `compare` and `results` wrote, and `identify` of measured controls."""
    blocks: list[Block] = []
    for name, title in TABLES.items():
        file = folder / name
        # a comparison without a pair has no test, and a file without a column
        if file.is_file() and file.read_text(encoding="utf-8").strip():
            # as text, so that what `compare` has rounded stays as it is
            blocks.append(frame_table(title, pd.read_csv(file, dtype=object).map(_rounded)))
    return [Section("Tables", blocks)] if blocks else []


def _rounded(told: object) -> object:
    """A number with more digits than anybody reads, with four."""
    if not isinstance(told, str) or not LONG.fullmatch(told):
        return told
    return f"{float(told):.4g}"


def _trajectory(file: Path) -> pd.DataFrame:
    with told_as_broken(file):
        return pd.read_csv(file, dtype="float64")


def read_trajectories(folder: Path) -> list[Section]:
    """What `simulate` wrote: each column over time, the models side by side.

    Raises:
        ValueError: A file is broken or has no rows.
    """
    files = sorted(folder.glob("trajectory_*.csv"))
    frames = {file.stem.removeprefix("trajectory_"): _trajectory(file) for file in files}
    if any(frame.empty for frame in frames.values()):
        raise ValueError(
            "`trajectory` must hold a row per step, but got none. Run simulate.py again."
        )
    if not frames:
        return []
    columns = dict.fromkeys(name for frame in frames.values() for name in frame.columns[1:])
    charts = [
        Chart(
            column.replace("_", " "),
            quantity(str(next(iter(frames.values())).columns[0])),
            quantity(column),
            {
                name: (frame.iloc[:, 0].tolist(), frame[column].tolist())
                for name, frame in frames.items()
                if column in frame
            },
        )
        for column in columns
    ]
    return [Section("Trajectories", charts)]
