"""A converted cache on disk: names of its files, and the state that says whether it can be used.

`data_converters/README.md` describes the whole of it.
"""

import json
from pathlib import Path
from typing import Any

from dmmv_conventions.checks import message, require

FORMAT_VERSION = 1
STATE_FILE = "cache.json"
REPORT_FILE = "conversion_report.json"
SPLITS = ("train", "val", "test")

LEAN_TABLE = "lean"
"""Measured lean beside the agents of a scene: agent_id, time_s (s), lean (rad, left positive)."""

CONTROLS_TABLE = "controls"
"""Recorded controls beside the agents of a scene: agent_id, time_s (s), one column per control."""

SENSORS_TABLE = "sensors"
"""Inertial and other sensors beside the agents of a scene: agent_id, time_s (s), their columns."""


def staging_folder(cache: Path, name: str, digest: str) -> Path:
    """Hidden folder in which environment `name` grows; `digest` is the hash of its settings."""
    return cache / f".converting_{name}_{digest}"


def side_table(scene: Path, table: str) -> Path:
    """File of a table that trajdata has no place for, beside the agents of a scene."""
    return scene / f"{table}.parquet"


def read_state(cache: Path, name: str, error: type[ValueError] = ValueError) -> dict[str, Any]:
    """The state file of a finished environment of this version.

    Args:
        cache: Folder of the cache.
        name: Name of the environment.
        error: Class of the error where it cannot be used.

    Returns:
        The content of `cache.json`.

    Raises:
        ValueError: The environment is absent, unfinished or of another version; of class `error`.
    """
    path = cache / name / STATE_FILE
    remedy = f"Run scripts/convert.py data={name} data.root=RECORDINGS data.cache={cache}"
    interrupted = any(cache.glob(staging_folder(Path(), name, "*").name))
    found = "an interrupted conversion" if interrupted else "no such file"
    requirement = f"hold a finished conversion of '{name}'"
    require(path.is_file(), "cache", requirement, found, f"at {path}", remedy, error)
    place = f"in {path}"
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as fault:
        requirement = "have a state in JSON"
        raise error(message("cache", requirement, fault, place, remedy)) from fault
    for field, wanted, told in (
        ("format_version", FORMAT_VERSION, str(FORMAT_VERSION)),
        ("complete", True, "true"),
    ):
        found = state.get(field)
        require(found == wanted, field, f"be {told}", found, place, remedy, error)
    return state
