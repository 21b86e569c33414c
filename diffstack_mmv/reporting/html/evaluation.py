"""Scores, errors over the horizon, calibration and scenes of an evaluation."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from diffstack_mmv.reporting.files import read_json
from diffstack_mmv.reporting.html.blocks import (
    Bars,
    Block,
    Chart,
    Scenes,
    Section,
    facts,
    frame_table,
)
from diffstack_mmv.reporting.html.scenes import planned_scene
from diffstack_mmv.reporting.metrics_table import (
    MISSING,
    baseline_table,
    cost_table,
    mode_table,
    situation_table,
)
from diffstack_mmv.reporting.scores import Scores

HORIZON_FILE = "error_over_horizon.json"
SCENES_FILE = "scenes.json"
COVERAGE = re.compile(r"coverage_(\d+)")


def read_evaluation(folder: Path, scores: Scores) -> list[Section]:
    """What `evaluate` wrote; nothing without `metrics.json`."""
    if not (folder / "metrics.json").is_file():
        return []
    metrics = read_json(folder / "metrics.json")
    sections = [_tables(_completed(metrics, scores), scores), _situations(metrics)]
    sections += [_horizon(folder), _calibration(metrics), _scenes(folder)]
    return [section for section in sections if section.blocks]


def _completed(metrics: Mapping[str, Any], scores: Scores) -> dict[str, Any]:
    """The content of a file that an earlier version may have written: what it lacks is unknown."""
    empty = {name: None for name in scores} | {"vehicle": metrics.get("vehicle"), MISSING: 0}
    modes = {mode: empty | told for mode, told in metrics["modes"].items()}
    absent = {"costs": {}, "situations": {}, "baselines": {}}
    return {**absent, **metrics, "modes": modes}


def _tables(metrics: Mapping[str, Any], scores: Scores) -> Section:
    by_mode = mode_table(metrics, scores).dropna(axis=1, how="all")
    blocks: list[Block] = [
        facts("Setting", metrics),
        frame_table("Scores by mode", by_mode, index=True),
        frame_table("Beside the trivial baselines", baseline_table(metrics, scores), index=True),
    ]
    costs = cost_table(metrics)
    if len(costs.columns):
        blocks.append(frame_table("Cost of the plan in hindsight by term", costs, index=True))
        terms = {str(mode): row.tolist() for mode, row in costs.iterrows()}
        blocks.append(Bars("Cost by term", "cost", [str(name) for name in costs.columns], terms))
    return Section("Evaluation", blocks)


def _situations(metrics: Mapping[str, Any]) -> Section:
    """ADE by situation, as a table and as bars, for each mode."""
    if not metrics.get("situations"):
        return Section("Situations", [])
    frame = situation_table(metrics)
    blocks: list[Block] = []
    for mode, group in frame.groupby("mode", sort=False):
        methods = [name for name in group.columns if name not in ("mode", "situation", "n")]
        numbers = {str(name): group[name].astype(float).tolist() for name in methods}
        labels = [f"{row.situation} ({row.n})" for row in group.itertuples()]
        blocks.append(Bars(f"ADE by situation: {mode}", "ADE [m]", labels, numbers))
    return Section("Situations", [*blocks, frame_table("ADE in m by situation", frame)])


def _horizon(folder: Path) -> Section:
    if not (folder / HORIZON_FILE).is_file():
        return Section("Error over the horizon", [])
    told = read_json(folder / HORIZON_FILE)
    charts = [
        Chart(
            mode,
            "time ahead [s]",
            told["heading"],
            {name.replace("_", " "): (told["time_s"], values) for name, values in methods.items()},
        )
        for mode, methods in told["errors"].items()
    ]
    return Section("Error over the horizon", charts)


def _calibration(metrics: Mapping[str, Any]) -> Section:
    """Share of positions within the regions that should hold so many, where the file has them."""
    lines = {}
    for mode, told in metrics["modes"].items():
        found = {COVERAGE.fullmatch(name): value for name, value in told.items()}
        pairs = sorted((int(match[1]), v) for match, v in found.items() if match and v is not None)
        if pairs:
            lines[mode] = ([each[0] / 100 for each in pairs], [each[1] for each in pairs])
    if not lines:
        return Section("Calibration", [])
    lines["ideal"] = ([0.0, 1.0], [0.0, 1.0])
    chart = Chart("Coverage of the forecast", "promised share", "observed share", lines, marks=True)
    return Section("Calibration", [chart])


def _scenes(folder: Path) -> Section:
    if not (folder / SCENES_FILE).is_file():
        return Section("Scenes", [])
    records = read_json(folder / SCENES_FILE)["scenes"]
    return Section("Scenes", [Scenes("", [planned_scene(record) for record in records])])


def horizon_content(
    errors: Mapping[str, Mapping[str, Any]], dt_s: float, heading: str
) -> dict[str, Any]:
    """Content of `error_over_horizon.json`.

    Args:
        errors: Mode -> method -> mean error (T,) in m, NaN where unknown.
        dt_s: Length of a step in s.
        heading: Title and unit of the error.
    """
    told = {
        mode: {
            name: [None if pd.isna(value) else round(float(value), 5) for value in error]
            for name, error in methods.items()
        }
        for mode, methods in errors.items()
    }
    steps = max((len(e) for methods in told.values() for e in methods.values()), default=0)
    time_s = [round(dt_s * (step + 1), 6) for step in range(steps)]
    return {"heading": heading, "time_s": time_s, "errors": told}
