"""Which tables below a folder are recordings, and which are what commands wrote there."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from functools import cache as remembered
from pathlib import Path

from dmmv_conventions.cache import REPORT_FILE, STATE_FILE

logger = logging.getLogger(__name__)

RUN_FOLDER = ".hydra"
"""What every command leaves in the folder of its run."""
EXPORT_FILE = "export.json"
"""What marks windows that a training cut from a cache, also where the cache is the root itself."""
RUN_FILE = "config.yaml"
"""The configuration of a run, which names its folder under `out`."""


def recorded(paths: Iterable[Path], root: Path) -> list[Path]:
    """Leave out what stands in a cache, in the folder of a run, or in a hidden folder below `root`.

    Otherwise a conversion that is repeated after a training would take reports for recordings,
    which would also deal the recordings anew.

    Args:
        paths: Files below `root`.
        root: Folder of the recordings, which is never left out itself.

    Returns:
        The rest, sorted.
    """
    is_output = remembered(_is_output)
    kept: list[Path] = []
    skipped: set[Path] = set()
    for path in sorted(set(paths)):
        above = [each for each in path.parents if each != root and each.is_relative_to(root)]
        outputs = [each for each in above if is_output(each)]
        if outputs:
            skipped.add(outputs[-1])
        else:
            kept.append(path)
    if skipped:
        names = ", ".join(sorted(str(each.relative_to(root)) for each in skipped))
        logger.info("Tables in folders that commands wrote are no recordings: %s", names)
    return kept


def _is_output(folder: Path) -> bool:
    """Whether a folder is hidden, a cache, an environment of one, or that of a run."""
    marks = (RUN_FOLDER, REPORT_FILE, STATE_FILE, EXPORT_FILE)
    if folder.name.startswith(".") or any((folder / mark).exists() for mark in marks):
        return True
    file = folder / RUN_FILE
    if not file.is_file():
        return False
    # a configuration of somebody else's recorder does not name the folder of a run
    lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
    return any(line.startswith("out:") for line in lines)
