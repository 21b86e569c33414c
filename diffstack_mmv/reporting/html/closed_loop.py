"""Scores, failures and playable episodes of a drive through a crowd."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from diffstack_mmv.reporting.closed_loop import closed_loop_table
from diffstack_mmv.reporting.files import read_json
from diffstack_mmv.reporting.html.blocks import (
    Block,
    Chart,
    Scenes,
    Section,
    facts,
    frame_table,
)
from diffstack_mmv.reporting.html.scenes import Surroundings, driven_scene
from diffstack_mmv.reporting.paired import paired_table
from diffstack_mmv.reporting.scores import Scores

RADIUS_M = 0.3  # of a pedestrian, where the run does not say
COLUMNS = ("case", "outcome", "time_s", "min_clearance_m", "discomfort_steps")


def read_closed_loop(folder: Path, scores: Scores, episodes: int) -> list[Section]:
    """What `navigate` wrote; nothing without `closed_loop.json`.

    Args:
        folder: The folder.
        scores: Titles and units.
        episodes: How many can be played, failures first.
    """
    if not (folder / "closed_loop.json").is_file():
        return []
    result = read_json(folder / "closed_loop.json")
    baselines = result.get("baselines", {})
    table = closed_loop_table(result, baselines, scores)
    blocks: list[Block] = [
        facts("Setting", {key: value for key, value in result.items() if key not in scores}),
        frame_table("Scores", table, index=True),
    ]
    if result.get("paired"):
        blocks.append(frame_table("Paired tests", paired_table(result["paired"], scores)))
    cases = pd.DataFrame(result["cases"])
    failed = cases[cases["outcome"] != "success"]
    shown = [name for name in COLUMNS if name in cases]
    if len(failed):
        blocks.append(frame_table("Cases without success", failed[shown], digits=2))
    numbers = cases["case"].tolist()
    nearest = cases["min_clearance_m"].astype(float).tolist()
    lines = {"smallest clearance": (numbers, nearest)}
    blocks.append(Chart("Smallest clearance by case", "case", "m", lines, marks=True))
    scenes = list(_episodes(folder, result, episodes))
    played = [Section("Episodes", [Scenes("", scenes)])] if scenes else []
    return [Section("Closed loop", blocks), *played]


def _episodes(folder: Path, result: Mapping[str, Any], count: int) -> Iterator[dict[str, Any]]:
    """The scenes of the first failures, then of the first successes."""
    around = _surroundings(folder, result)
    order = sorted(result["cases"], key=lambda case: case["outcome"] == "success")
    wanted = {case["case"]: case for case in order[:count]}
    found: dict[int, dict[str, Any]] = {}
    for file in sorted((folder / "episodes" / result["controller"]).glob("*.npz")):
        with np.load(file) as stored:
            inside = [case for case in stored["cases"].tolist() if case in wanted]
            arrays = {name: stored[name] for name in stored.files} if inside else {}
        for case in inside:
            told = wanted[case]
            title = f"case {case}: {told['outcome']} after {told['time_s']:.2f} s"
            row = arrays["cases"].tolist().index(case)
            found[case] = driven_scene(title, arrays, row, around)
    yield from (found[case] for case in wanted if case in found)


def _surroundings(folder: Path, result: Mapping[str, Any]) -> Surroundings:
    """What the configuration of the run tells of the world."""
    file = folder / "config.yaml"
    config = yaml.safe_load(file.read_text(encoding="utf-8")) if file.is_file() else {}
    scenario = config.get("scenario", {})
    reach = scenario.get("circle_radius_m")
    model = result.get("actual_model", {})
    return Surroundings(
        dt_s=result["dt_s"],
        radius_m=scenario.get("pedestrian_radius_m", RADIUS_M),
        goal_m=None if reach is None else (0.0, reach),
        footprint=model.get("footprint", {}),
        controls=model.get("controls", ()),
    )
