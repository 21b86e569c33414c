"""`identification.json` and `identification.md` from the numbers of an identification."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from diffstack_mmv.reporting.files import write_json, write_text
from diffstack_mmv.reporting.table import markdown_table

BEYOND = 0.01  # share of the samples beyond the limits of the vehicle that is told


def write_identification(folder: Path, result: Mapping[str, Any]) -> None:
    """Write `identification.json` and `identification.md` into a folder.

    Args:
        folder: The folder.
        result: Numbers, with the header (data, vehicle, dynamics, mode, seed) and the tracking
            errors of other models under "models".

    Raises:
        ValueError: A number is NaN or infinite.
    """
    write_json(folder / "identification.json", result)
    write_text(folder / "identification.md", _markdown(result))


def write_tables(
    folder: Path, result: Mapping[str, Any], tables: Mapping[str, Sequence[Mapping[str, Any]]]
) -> None:
    """Write `identification.json`, `identification.md` with a table under each heading, and CSV.

    Args:
        folder: The folder.
        result: All numbers, and what there is to remark under "remarks".
        tables: Rows by heading.

    Raises:
        ValueError: A number is NaN or infinite.
    """
    write_json(folder / "identification.json", result)
    parts = [f"# {result['vehicle']}: {result['dynamics']}, measured controls", *result["remarks"]]
    for heading, rows in tables.items():
        table = pd.DataFrame(list(rows))
        parts.append(f"## {heading}\n\n" + markdown_table(table.round(4), ""))
        name = heading.lower().replace("-", "")
        write_text(folder / f"{name}.csv", table.to_csv(index=False, lineterminator="\n"))
    write_text(folder / "identification.md", "\n\n".join(parts) + "\n")


def _number(value: float) -> str:
    return f"{value:.4g}"


def _rows(entries: Mapping[str, Mapping[str, Any]], ranged: bool) -> pd.DataFrame:
    """Table of parameters or combinations: prior, estimate, how sure, verdict."""
    rows = []
    for name, entry in entries.items():
        row = {"": name, "prior": f"{_number(entry['initial'])} ± {_number(entry['prior_std'])}"}
        if ranged:
            row["range"] = f"[{_number(entry['low'])}, {_number(entry['high'])}]"
        row["estimate"] = f"{_number(entry['estimate'])} ± {_number(entry['std'])}"
        row["unit"] = entry["unit"]
        row["identifiability"] = f"{entry['identifiability']:.2f}"
        row["verdict"] = entry["verdict"]
        rows.append(row)
    return pd.DataFrame(rows)


def _verdicts(parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """How many parameters the tracks inform, and how the table is to be read."""
    names = [name for name, each in parameters.items() if each["verdict"] == "identifiable"]
    known = [each["verdict"] for each in parameters.values()]
    silent = known.count("not identifiable")
    told = f"Identifiable: {', '.join(names) or 'none'} (of {len(parameters)} parameters)."
    if silent == len(parameters):
        told += " The tracks inform no parameter: vehicle.yaml has the numbers it had before."
    elif silent:
        told += f" {silent} of them stay at their priors."
    return (
        f"{told} Prior and estimate are told with one standard deviation. Identifiability is the "
        "share of the prior's deviation that the tracks removed, 0 for none and 1 for all.\n\n"
    )


def models_table(models: Mapping[str, Mapping[str, float]]) -> pd.DataFrame:
    """Tracking errors in m of each model, on fitted and on held-out tracks."""
    rows = [{"model": name, **errors} for name, errors in models.items()]
    return pd.DataFrame(rows)


def validation_table(models: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """Errors in m of each model on held-out segments, with the difference to the first one."""
    rows = []
    for name, errors in models.items():
        row: dict[str, object] = {"model": name}
        for kind in ("followed", "foreseen"):
            change, spread = errors[f"{kind}_change"], errors[f"{kind}_change_std"]
            row[kind] = f"{errors[kind]:.4f}"
            told = f"{change:+.4f}" + ("" if spread is None else f" ± {spread:.4f}")
            row[f"{kind}: mean change"] = told
        rows.append(row)
    return pd.DataFrame(rows)


def _validation(result: Mapping[str, Any]) -> str:
    """Errors of the models on segments that they were not fitted to."""
    told = result["validation"]
    how = f"each held out once in {told['folds']} folds" if told["folds"] else "held out"
    text = (
        f"{told['stretches']} track segments, {how}. Followed: distance between the track and the "
        "fit, which is mostly noise. Foreseen: distance over the last "
        f"{told['foresee_s']:g} s of a segment, whose controls were inferred from what came before "
        f"and held. Changes are means over the segments, against {result['dynamics']}, with "
        "standard errors.\n\n"
    )
    return text + markdown_table(validation_table(told["models"])) + "\n"


def _assumed(result: Mapping[str, Any]) -> str:
    """Noise and rider of the tracking problem, in words."""
    assumed, beyond = result["assumed"], result["beyond_limits"]
    text = (
        f"\n\nAssumed of every model: noise of {assumed['along_m']:.3f} m along and "
        f"{assumed['across_m']:.3f} m across the motion per step; a rider who changes acceleration "
        f"by {assumed['jerk_mps3']:.2f} m/s³ and curvature by {assumed['curvature_rate']:.3f} "
        "1/(m s)."
    )
    if beyond > BEYOND:
        text += (
            f" In {100 * beyond:.0f} % of the samples the recording accelerates or brakes harder "
            "than the limits of the vehicle allow: there no model follows it."
        )
    return text


def _lean(result: Mapping[str, Any]) -> str:
    """Lean of the model against the measured one, in words."""
    lean = result["lean"]
    text = (
        f"\n## Lean\n\nThe model's lean differs from the measured one, which no fit uses, by "
        f"{lean['rms_difference_rad']:.3f} rad (root mean square; measured "
        f"{lean['rms_measured_rad']:.3f})"
    )
    if lean["correlation"] is None or lean["correlation_late"] is None:
        return f"{text}. One of them does not vary: there is no correlation.\n"
    return (
        f"{text}, correlation {lean['correlation']:.2f}. It comes "
        f"{lean['late_s']:.1f} s late: moved back by that, the correlation is "
        f"{lean['correlation_late']:.2f}.\n"
    )


def _markdown(result: Mapping[str, Any]) -> str:
    title = f"# Identification: {result['vehicle']} · {result['dynamics']} · {result['data']}\n\n"
    setting = (
        f"{result['tracks']} tracks fitted, {result['heldout_tracks']} held out, mode "
        f"`{result['mode']}`, seed {result['seed']}. Errors are root mean square distances in m; "
        "the tracking problem is the same for all models.\n\n"
    )
    parts = [
        title,
        setting,
        markdown_table(models_table(result["models"]), ".4f"),
    ]
    if "assumed" in result:
        parts.append(_assumed(result))
    if "validation" in result:
        parts += ["\n\n## Models on held-out segments\n\n", _validation(result)]
    if result["parameters"]:
        parts += ["\n\n## Parameters\n\n", _verdicts(result["parameters"])]
        parts.append(markdown_table(_rows(result["parameters"], True)))
    if result["combinations"]:
        parts += ["\n\n## Combinations\n\n", markdown_table(_rows(result["combinations"], False))]
    parts += ["\n\n## What the tracks say\n\n", *[f"- {each}\n" for each in result["remarks"]]]
    if result.get("lean"):
        parts.append(_lean(result))
    if result["regularisation_influence"]:
        parts += ["\n## Influence of the regularisation\n\n", _influence(result)]
    return "".join(parts).rstrip() + "\n"


def _influence(result: Mapping[str, Any]) -> str:
    told = (
        "Change of each estimate, in its prior standard deviations, if the assumed standard "
        "deviation in the head of the column were twice as large (first order).\n\n"
    )
    frame = pd.DataFrame(result["regularisation_influence"])
    frame.index.name = "parameter"
    return told + markdown_table(frame, ".2f", index=True) + "\n"
