"""A report is not lost to another one that is written into the same folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diffstack_mmv.reporting.files import read_json

IDENTITY = (
    *("data", "split", "goal", "dynamics", "vehicle", "seed", "smoother", "calibrated_on"),
    *("ego_modes", "plans", "history_s", "stride", "judged_situations", "solver", "ensemble"),
    *("steadiness", "draws_seed"),
)
"""What tells reports apart: not the code, so that an evaluation can be repeated by another one."""


def require_same_evaluation(folder: Path, header: Mapping[str, Any]) -> None:
    """Refuse a folder that holds the report of another checkpoint or with other settings.

    A checkpoint of the same path is the same run, whose training may have gone on.

    Args:
        folder: Where a report is to be written.
        header: Its own header, as in `metrics.json`.

    Raises:
        ValueError: There is another report.
    """
    path = folder / "metrics.json"
    if not path.is_file():
        return
    before = read_json(path)
    # reports of earlier versions do not tell all of it
    told = [name for name in IDENTITY if name in before]
    differing = [name for name in told if before[name] != header.get(name)]
    if before.get("checkpoint_sha256") != header.get("checkpoint_sha256"):
        first, second = (_place(told.get("checkpoint")) for told in (before, header))
        differing += ["checkpoint"] if first != second else []
    if differing:
        name = differing[0]
        raise ValueError(
            f"`out` must hold no report with another {name} than {header.get(name)}, but got "
            f"{before.get(name)} in {path}. Give another out=FOLDER, or delete {folder}."
        )


def require_same_drive(folder: Path, controller: str) -> None:
    """Refuse a folder that holds the report of another controller; episodes tell the rest.

    Args:
        folder: Where a report is to be written.
        controller: Name of what drives.

    Raises:
        ValueError: There is another report.
    """
    path = folder / "closed_loop.json"
    before = read_json(path)["controller"] if path.is_file() else controller
    if before != controller:
        raise ValueError(
            f"`out` must hold no report of another controller than {controller}, but got {before} "
            f"in {path}. Give another out=FOLDER, or delete {folder}."
        )


def _place(checkpoint: str | None) -> Path | None:
    return None if checkpoint is None else Path(checkpoint).resolve()
