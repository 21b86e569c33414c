"""`identification.json` and `identification.md` from the numbers of an identification."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from diffstack_mmv.reporting.files import write_json, write_text


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


def models_table(models: Mapping[str, Mapping[str, float]]) -> pd.DataFrame:
    """Tracking errors in m of each model, on fitted and on held-out tracks."""
    rows = [{"model": name, **errors} for name, errors in models.items()]
    return pd.DataFrame(rows)


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
        models_table(result["models"]).to_markdown(index=False, floatfmt=".4f"),
    ]
    if result["parameters"]:
        parts += ["\n\n## Parameters\n\n", _text(_rows(result["parameters"], True))]
    if result["combinations"]:
        parts += ["\n\n## Combinations\n\n", _text(_rows(result["combinations"], False))]
    parts += ["\n\n## What the tracks say\n\n", *[f"- {each}\n" for each in result["remarks"]]]
    if result["regularisation_influence"]:
        parts += ["\n## Influence of the regularisation\n\n", _influence(result)]
    return "".join(parts).rstrip() + "\n"


def _text(frame: pd.DataFrame) -> str:
    return frame.to_markdown(index=False, disable_numparse=True)


def _influence(result: Mapping[str, Any]) -> str:
    told = (
        "Change of each estimate, in its prior standard deviations, if the assumed standard "
        "deviation in the head of the column were twice as large (first order).\n\n"
    )
    frame = pd.DataFrame(result["regularisation_influence"])
    frame.index.name = "parameter"
    return told + frame.to_markdown(floatfmt=".2f") + "\n"
