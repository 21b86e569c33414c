"""`closed_loop.json` and `closed_loop.md` from the numbers of a benchmark."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from diffstack_mmv.reporting.files import write_json, write_text
from diffstack_mmv.reporting.paired import paired_table
from diffstack_mmv.reporting.scores import Scores
from diffstack_mmv.reporting.table import cell, markdown_table, with_interval

WITH_INTERVAL = ("success_rate", "collision_rate")
# what a published row and a drive share where they can be compared
SETTING = ["scenario", "humans"]


def write_closed_loop(
    folder: Path,
    result: Mapping[str, Any],
    baselines: Mapping[str, Mapping[str, Any]],
    scores: Scores,
    published: Sequence[Mapping[str, Any]] = (),
    pairs: Sequence[Mapping[str, Any]] = (),
) -> None:
    """Write `closed_loop.md` and, last, `closed_loop.json` into a folder.

    Args:
        folder: The folder.
        result: Header and numbers of the controller; the keys are those of the file.
        baselines: Numbers of each baseline; its cases go into the file as well.
        scores: Titles and units of the scores, in the order of the columns.
        published: Rows of published methods, each with its source; those that name another
            `scenario` or number of `humans` than the result's are left out.
        pairs: Paired tests against other methods and runs, see `paired_cases`.

    Raises:
        ValueError: A number is NaN or infinite.
    """
    comparable = [each for each in published if _same_setting(each, result)]
    told = [_summary(result, baselines, scores), _paired(pairs, scores), _published(comparable)]
    write_text(folder / "closed_loop.md", "\n\n".join(part for part in told if part) + "\n")
    # by this file a table knows that the drive is done
    write_json(folder / "closed_loop.json", _content(result, baselines, pairs))


def closed_loop_table(
    result: Mapping[str, Any], baselines: Mapping[str, Mapping[str, Any]], scores: Scores
) -> pd.DataFrame:
    """One row per method: shares with intervals of 95 %, times in s, distances in m."""
    own = f"{result['controller']} ({result['dynamics']} {result['vehicle']})"
    rows = {
        name: {"n": str(each["n"])} | score_cells(each, scores)
        for name, each in {own: result, **baselines}.items()
    }
    frame = pd.DataFrame.from_dict(rows, orient="index")
    frame.index.name = "method"
    return frame


def score_cells(numbers: Mapping[str, Any], scores: Scores) -> dict[str, str]:
    """The scores of one drive as text, by their headings.

    Shares have their intervals; of processor times, median and 99th percentile are told.
    """
    return {score.heading: _score_cell(numbers, name) for name, score in scores.items()}


def _score_cell(numbers: Mapping[str, Any], name: str) -> str:
    value = numbers.get(name)
    if name in WITH_INTERVAL:
        return with_interval(value, numbers[f"{name}_ci95"])
    if isinstance(value, Mapping):
        return f"{value['median']:.1f} / {value['p99']:.1f}"
    return cell(value)


def _content(
    result: Mapping[str, Any],
    baselines: Mapping[str, Mapping[str, Any]],
    pairs: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """What the JSON file holds."""
    return {**result, "baselines": dict(baselines), "paired": list(pairs)}


def _summary(
    result: Mapping[str, Any], baselines: Mapping[str, Mapping[str, Any]], scores: Scores
) -> str:
    """Setting, scores and failures."""
    last = result["first_case"] + result["n"] - 1
    title = f"# Closed loop: {result['vehicle']} · {result['dynamics']} · {result['scenario']}\n\n"
    limits = ", ".join(f"{name} {value:g}" for name, value in result["limits"].items())
    setting = (
        f"{_people(result)}, {result['phase']} cases {result['first_case']}–{last} "
        f"in batches of up to {result['chunk']}, limit {result['limit_s']:g} s, "
        f"step {result['dt_s']:g} s, verdict `{result['verdict']}`. Limits: {limits} (or the "
        "tighter ones of the vehicle). Footprint: "
        f"{_outline(result['actual_model']['footprint'])}; massless baselines always have the disc "
        f"of 0.3 m. The robot is {_model(result['dynamics'], result['actual_model'])}, the "
        f"controller believes in {_model(result['believed_dynamics'], result['believed_model'])}. "
        f"{_choices(result)}Brackets: Wilson intervals of 95 %.\n\n"
    )
    table = markdown_table(closed_loop_table(result, baselines, scores), index=True)
    table = f"{table}\n\n{_times(result)}" if "real_time_factor" in result else table
    failed = [case for case in result["cases"] if case["outcome"] != "success"]
    table = f"{table}\n\n{_feasible(result)}" if "feasible" in result else table
    return f"{title}{setting}{table}\n\n## Cases without success\n\n{_failures(failed)}"


def _people(result: Mapping[str, Any]) -> str:
    """Who walks, and where they were recorded if they were."""
    number = result["humans"]
    recorded = f"Up to {number} agents at once of the recordings of {result.get('data')}"
    return recorded if "data" in result else f"{number} pedestrians"


def _choices(result: Mapping[str, Any]) -> str:
    """Who walks, what is known of them, and in what the robot is not what the controller thinks."""
    sees = "see" if result["robot_visible"] else "do not see"
    told = ", ".join(f"{group} `{option}`" for group, option in result["choices"].items())
    disturbed = [
        f"{name} {value}"
        for name, value in result["disturbances"].items()
        if value not in (None, [], 1.0 if name.endswith("_factor") else 0.0)
    ]
    disturbances = f" Disturbances: {', '.join(disturbed)}." if disturbed else ""
    return f"The pedestrians {sees} the robot; {told}.{disturbances} "


def _feasible(result: Mapping[str, Any]) -> str:
    """Scores without the cases that nobody could have passed."""
    told = result["feasible"]
    return (
        f"Feasible cases: {told['n']} of {result['n']}, success {cell(told['success_rate'])}, "
        f"collision {cell(told['collision_rate'])}. A case is not feasible where the vehicle "
        "collides in each of many random drives that know the walks (`avoidable`: share without "
        "collision)."
    )


def _times(result: Mapping[str, Any]) -> str:
    """Whether the decisions keep up, and how many solves converge."""
    told = (
        "Real-time factor (time driven over processor time of the decisions): "
        f"{result['real_time_factor']:.1f}."
    )
    solved = result.get("solved_share")
    return told if solved is None else f"{told} Solves that converge: {cell(solved)}."


def _model(name: str, model: Mapping[str, Any]) -> str:
    """A model in words."""
    parts = [model["class"], model["tyre_law"], f"step {model['step_s']:g} s"]
    parts.append(f"{model['substeps']} substeps" if model["substeps"] > 1 else None)
    return f"{name} ({', '.join(part for part in parts if part)})"


def _outline(footprint: Mapping[str, Any]) -> str:
    """A footprint in words."""
    sizes = [f"{name} {value:g}" for name, value in footprint.items() if name != "shape"]
    return f"{footprint['shape']} ({', '.join(sizes)})"


def _paired(pairs: Sequence[Mapping[str, Any]], scores: Scores) -> str:
    """The paired tests, if there are any."""
    if not pairs:
        return ""
    told = (
        "Case by case; differences are this run minus the other. Success and collision: McNemar's "
        "exact test; time (where both succeed) and discomfort: Wilcoxon's signed-rank test."
    )
    return f"## Paired tests\n\n{told}\n\n{markdown_table(paired_table(pairs, scores))}"


def _same_setting(published: Mapping[str, Any], result: Mapping[str, Any]) -> bool:
    """Whether a published row names no other scenario and number of people than the result's."""
    return all(published.get(name, result[name]) == result[name] for name in SETTING)


def _published(published: Sequence[Mapping[str, Any]]) -> str:
    """The published methods, if there are any."""
    if not published:
        return ""
    frame = pd.DataFrame(published).astype(object).drop(columns=SETTING, errors="ignore")
    table = markdown_table(frame, "g")
    return f"## Published methods\n\nOther robots, limits and rules: see each source.\n\n{table}"


def _failures(cases: Sequence[Mapping[str, Any]]) -> str:
    """Table of the cases that failed."""
    if not cases:
        return "None."
    columns = ["case", "outcome", "time_s", "min_clearance_m"]
    frame = pd.DataFrame(cases)
    if "avoidable" in frame:
        columns.append("avoidable")
    return markdown_table(frame[columns], ".2f")
