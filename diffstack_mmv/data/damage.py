"""Files of a cache that are lost, cut off or of another program: told as such."""

import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pyarrow.lib import ArrowException

from diffstack_mmv.checks import message

# what pandas, pyarrow and the pickles of trajdata raise, whichever part of a file is hit
_BROKEN = (
    ArrowException,
    AttributeError,
    EOFError,
    ImportError,
    LookupError,
    OSError,
    TypeError,
    ValueError,
    pickle.UnpicklingError,
)


@contextmanager
def told_as_damage(path: Path, remedy: str) -> Iterator[None]:
    """Tell what goes wrong while a file of a cache is read as its fault.

    Args:
        path: The file, or the folder where it should be.
        remedy: How to make it anew.

    Raises:
        ValueError: It cannot be read.
    """
    try:
        yield
    except _BROKEN as broken:
        told = (str(broken).splitlines() or [""])[0] or type(broken).__name__
        text = message("cache", "hold the files of its conversion", told, f"at {path}", remedy)
        raise ValueError(text) from broken


def only_file(folder: Path, pattern: str) -> Path:
    """The file of a scene that a pattern names; where there is none, the pattern itself."""
    return next(folder.glob(pattern), folder / pattern)
