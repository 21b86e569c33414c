"""Checks of folders that commands have written; they need nothing heavy, like `config_checks`."""

from collections.abc import Sequence
from pathlib import Path

from diffstack_mmv.config_checks import require_file, require_folder
from dmmv_conventions.checks import require


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
