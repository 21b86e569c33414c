"""A converted cache on disk: names of its files, and the state that says whether it can be used.

`data_converters/README.md` describes the whole of it.
"""

import json
import os
import shlex
from collections.abc import Iterable, Mapping
from functools import cache as remembered
from pathlib import Path
from typing import Any

from dmmv_conventions.checks import message, require
from dmmv_conventions.data_names import choice_of

FORMAT_VERSION = 1
STATE_FILE = "cache.json"
REPORT_FILE = "conversion_report.json"
SPLITS = ("train", "val", "test")

LEAN_TABLE = "lean"
"""Measured lean beside the agents of a scene: agent_id, time_s (s), lean (rad, left positive)."""

TRUSTED_VARIABLE = "DMMV_TRUSTED_CACHES"
"""Environment variable with folders of caches of others that are read all the same, by colons."""

ADMINISTRATOR = 0
"""User whose files everyone trusts anyway."""

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
    remedy = conversion_of(name, cache)
    interrupted = any(cache.glob(staging_folder(Path(), name, "*").name))
    found = "an interrupted conversion" if interrupted else "no such file"
    requirement = f"hold a finished conversion of '{name}'"
    require(path.is_file(), "cache", requirement, found, f"at {path}", remedy, error)
    place = f"in {path}"
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as fault:
        requirement = "have a state in JSON"
        raise error(message("cache", requirement, fault, place, remedy)) from fault
    require(isinstance(state, dict), "cache", "have a state in JSON", state, place, remedy, error)
    for field, wanted, told in (
        ("format_version", FORMAT_VERSION, str(FORMAT_VERSION)),
        ("complete", True, "true"),
    ):
        found = state.get(field)
        require(found == wanted, field, f"be {told}", found, place, remedy, error)
    return state


def recordings_by_scene(scenes: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """By its name the recording that each of the `scenes` of a state is part of, or is itself."""
    return {scene["name"]: scene.get("recording", scene["name"]) for scene in scenes}


def conversion_of(name: str, cache: Path) -> str:
    """The sentence with the command that makes an environment."""
    return f"Run {conversion_command(name, cache)}"


def conversion_command(name: str, cache: Path) -> str:
    """The command that makes an environment in the folder of a cache."""
    place = shlex.quote(f"data.cache={cache}")
    return f"python scripts/convert.py {choice_of(name)} data.root=RECORDINGS {place}"


def require_own(folder: Path, remedy: str) -> None:
    """Refuse a folder with pickles of another user: reading them runs whatever they hold.

    Files of the administrator are taken, and those below the folders in `TRUSTED_VARIABLE`.

    Args:
        folder: Folder of an environment.
        remedy: How to make it anew.

    Raises:
        ValueError: A file belongs to another user.
    """
    trusted = [place for place in os.environ.get(TRUSTED_VARIABLE, "").split(os.pathsep) if place]
    if any(folder.resolve().is_relative_to(Path(place).resolve()) for place in trusted):
        return
    foreign = _foreign(folder.resolve())
    told = f"{foreign}, which user {foreign.stat().st_uid if foreign else 0} wrote"
    advice = f"{remedy} to make your own, or set {TRUSTED_VARIABLE}={folder.parent} to trust it."
    requirement = "be written by you, because reading it runs code that stands in it"
    require(foreign is None, "cache", requirement, told, "", advice)


@remembered
def _foreign(folder: Path) -> Path | None:
    """The first file or folder of another user, also behind links."""
    own = {ADMINISTRATOR, os.geteuid()}
    pending, seen = [folder], set()
    while pending:
        place = pending.pop()
        place = place.resolve() if place.is_symlink() else place
        if place in seen or not place.exists():  # nothing is read from a link to nowhere
            continue
        seen.add(place)
        if place.stat().st_uid not in own:
            return place
        if place.is_dir():
            pending += place.iterdir()
    return None
