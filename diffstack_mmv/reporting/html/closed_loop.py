"""Scores, failures and playable episodes of a drive through a crowd."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from diffstack_mmv.reporting.closed_loop import closed_loop_table
from diffstack_mmv.reporting.files import read_config, read_json
from diffstack_mmv.reporting.html.blocks import (
    Block,
    Chart,
    Scenes,
    Section,
    facts,
    frame_table,
)
from diffstack_mmv.reporting.html.scenes import Surroundings, driven_scene, side_by_side
from diffstack_mmv.reporting.paired import CASES, paired_table, require_same
from diffstack_mmv.reporting.scores import Scores
from dmmv_conventions.archives import opened_arrays

RADIUS_M = 0.3  # of a pedestrian, where the run does not say
COLUMNS = ("case", "outcome", "time_s", "min_clearance_m", "discomfort_steps")


def read_closed_loop(
    folder: Path, scores: Scores, episodes: int, beside: Path | None = None
) -> list[Section]:
    """What `navigate` wrote; nothing without `closed_loop.json`.

    Args:
        folder: The folder.
        scores: Titles and units.
        episodes: How many can be played, failures first.
        beside: Another drive over the same cases, which is shown to the right of this one; cases
            that end differently come first.

    Raises:
        ValueError: `beside` has other cases.
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
    order = sorted(result["cases"], key=lambda case: case["outcome"] == "success")
    if beside is None:
        scenes = list(_episodes(folder, result, order[:episodes]).values())
    else:
        scenes = list(_pairs(folder, result, beside, episodes))
    played = [Section("Episodes", [Scenes("", scenes)])] if scenes else []
    return [Section("Closed loop", blocks), *played]


def _pairs(
    folder: Path, result: Mapping[str, Any], beside: Path, count: int
) -> Iterator[dict[str, Any]]:
    """The scenes of both drives side by side, first of the cases that end differently."""
    other = read_json(beside / "closed_loop.json")
    require_same(CASES, result, other, "beside", beside)
    theirs = {case["case"]: case for case in other["cases"]}
    shared = [case for case in result["cases"] if case["case"] in theirs]
    shared.sort(key=lambda case: case["outcome"] == theirs[case["case"]]["outcome"])
    left = _episodes(folder, result, shared[:count])
    right = _episodes(beside, other, [theirs[case["case"]] for case in shared[:count]])
    names = f"{result['controller']} (left), {other['controller']} (right)"
    for case in left:
        ends = f"{left[case]['title']} / {right[case]['title'].split(': ')[1]}"
        yield side_by_side(f"{ends}: {names}", left[case], right[case])


def _episodes(
    folder: Path, result: Mapping[str, Any], cases: Sequence[Mapping[str, Any]]
) -> dict[int, dict[str, Any]]:
    """The scenes of some cases by their numbers, in their order."""
    around = _surroundings(folder, result)
    wanted = {case["case"]: case for case in cases}
    found: dict[int, dict[str, Any]] = {}
    for file in sorted((folder / "episodes" / result["controller"]).glob("*.npz")):
        with opened_arrays(file) as stored:
            inside = [case for case in stored["cases"].tolist() if case in wanted]
            arrays = {name: stored[name] for name in stored.files} if inside else {}
        for case in inside:
            told = wanted[case]
            title = f"case {case}: {told['outcome']} after {told['time_s']:.2f} s"
            row = arrays["cases"].tolist().index(case)
            found[case] = driven_scene(title, arrays, row, around)
    return {case: found[case] for case in wanted if case in found}


def _surroundings(folder: Path, result: Mapping[str, Any]) -> Surroundings:
    """What the configuration of the run tells of the world."""
    config = read_config(folder)
    scenario = config.get("scenario", {})
    drawn = "arena_m" in scenario  # then every case has a goal of its own
    reach = None if drawn else scenario.get("circle_radius_m")
    model = result.get("actual_model", {})
    return Surroundings(
        dt_s=result["dt_s"],
        radius_m=scenario.get("pedestrian_radius_m", RADIUS_M),
        goal_m=None if reach is None else (0.0, reach),
        footprint=model.get("footprint", {}),
        controls=model.get("controls", ()),
    )
