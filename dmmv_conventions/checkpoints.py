"""Reading of a checkpoint without running code that stands in it."""

import re
from pathlib import Path
from typing import Any

import torch

from dmmv_conventions.archives import BROKEN, require_sums
from dmmv_conventions.checks import message, require

_FOREIGN = re.compile(r"\bGLOBAL ([\w.]+)")
"""How torch names what a pickle would call."""


def read_plain(path: Path, remedy: str) -> Any:
    """Content of a checkpoint on the CPU: tensors and plain values only.

    Args:
        path: The file.
        remedy: One sentence that says what to do where it cannot be used.

    Raises:
        ValueError: The file is missing, broken, or holds anything but tensors and plain values.
    """
    require(path.is_file(), "checkpoint", "be an existing file", repr(str(path)), "", remedy)
    try:
        require_sums(path)
        return torch.load(path, map_location="cpu", weights_only=True)
    except BROKEN as broken:
        needed, told = _told(str(broken) or type(broken).__name__)
        raise ValueError(message("checkpoint", needed, told, f"in {path}", remedy)) from broken


def _told(broken: str) -> tuple[str, str]:
    """Requirement and finding; torch itself would advise to run the code all the same."""
    foreign = _FOREIGN.search(broken)
    if foreign:
        return "be readable without running code", f"{foreign[1]} in it"
    first = broken.splitlines()[0]
    return "be readable", "no checkpoint" if first.startswith("Weights only") else first
