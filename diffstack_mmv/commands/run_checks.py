"""Checks of folders that commands have written; they need nothing heavy, like `config_checks`."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from diffstack_mmv.commands.config_checks import require_file, require_folder
from dmmv_conventions.checks import message, require
from dmmv_conventions.differences import first_difference
from dmmv_conventions.yaml_files import read_plain


def require_reports(runs: Sequence[str]) -> None:
    """Refuse folders that scripts/evaluate.py did not write.

    Raises:
        ValueError: There is no folder, or no `metrics.json` in one, or one is named twice.
    """
    remedy = "Give those that evaluate.py wrote."
    require(len(runs) > 0, "runs", "name at least one folder", "[]", "", remedy)
    for run in runs:
        require_file("runs", str(Path(run) / "metrics.json"), remedy)
    places = [Path(run).resolve() for run in runs]
    twice = [str(run) for run, place in zip(runs, places, strict=True) if places.count(place) > 1]
    told = " and ".join(twice)
    require(not twice, "runs", "name each folder once", told, "", "Leave one of them out.")


RESULTS = (
    "metrics.json",
    "closed_loop.json",
    "identification.json",
    "table.csv",
    "results.csv",
    "trajectory_*.csv",
    "csv/metrics.csv",
)
"""What the commands write that a page can show."""


def require_results(runs: Sequence[str]) -> None:
    """Refuse folders in which no command has written its results.

    Raises:
        ValueError: No folder is given, one is absent, or holds no results.
    """
    remedy = "Give folders that train, evaluate, navigate, identify, simulate or compare wrote."
    require(len(runs) > 0, "runs", "name at least one folder", "[]", "", remedy)
    for run in runs:
        require_folder("runs", run, remedy)
        found = any(next(Path(run).glob(pattern), None) for pattern in RESULTS)
        require(found, "runs", "hold results", "none", f"in {run}", remedy)


OF_A_COMMAND = {
    "train": "checkpoints/last.ckpt",
    "evaluate": "metrics.json",
    "compare": "tests.csv",
    "navigate": "closed_loop.json",
    "identify": "identification.json",
    "results": "results.csv",
    "closed_loop_table": "drives",
    "simulate": "trajectory_*.csv",
    "tune": "rounds.json",
    "train_policy": "policy*.zip",
}
"""By what the folder of a command is known; its `config.yaml` is that of this command."""


def require_own_folder(out: Path, name: str) -> None:
    """Refuse a folder in which another command has left its results.

    A command that leaves none of these files may write beside them, as a page does.

    Args:
        out: The folder.
        name: Name of the command.

    Raises:
        ValueError: There is what another command writes.
    """
    found = _of_another(out, name) if name in OF_A_COMMAND else None
    told = "" if found is None else f"{found.file} of {found.command}"
    remedy = "Give another out=FOLDER, for example one within it."
    require(found is None, "out", f"hold results of {name} alone", told, f"in {out}", remedy)


def require_same_run(out: Path, name: str, config: Mapping[str, Any]) -> None:
    """Refuse a folder in which the command has left results of other settings.

    Args:
        out: The folder.
        name: Name of the command.
        config: Its configuration, resolved, as plain containers.

    Raises:
        ValueError: A setting differs from that in `config.yaml`, or that file is broken.
    """
    file = out / "config.yaml"
    if not file.is_file() or next(out.glob(OF_A_COMMAND[name]), None) is None:
        return
    remedy = f"Give another out=FOLDER, or delete {out}."
    before = read_plain(file, "out", remedy)
    found = first_difference(before, config, _SHOWN)
    if found is not None:
        wanted = f"hold no result of {name} with another {found.place} than {found.now!r}"
        raise ValueError(message("out", wanted, repr(found.before), f"in {file}", remedy))


_SHOWN = re.compile(r"(out|vehicle_file|dry_run|wandb)(\.|\[|$)")
"""Where and how a run is shown decides no result."""


def require_own_config(found: str, name: str) -> None:
    """Refuse another file in place of the command's own: one of a run has its folder everywhere.

    Raises:
        ValueError: `found`, the composed file, is not that of the command `name`.
    """
    remedy = "To repeat a run give the words in the first line of its config.yaml, another `out`."
    require(found == name, "config-name", f"be {name}", found, "", remedy)


def config_file(out: Path, name: str) -> Path:
    """Where a command writes its configuration: not over that of the run whose folder it is."""
    own = _of_another(out, name) is None
    return out / ("config.yaml" if own else f"{name}_config.yaml")


class _Results(NamedTuple):
    command: str
    file: Path


def _of_another(out: Path, name: str) -> _Results | None:
    for other, pattern in OF_A_COMMAND.items():
        found = None if other == name else next(out.glob(pattern), None)
        if found is not None:
            return _Results(other, found.relative_to(out))
    return None
