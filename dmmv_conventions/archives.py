"""Archives of arrays and checkpoints: a part that is not what was written is told, not read."""

import pickle
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.lib.npyio import NpzFile

from dmmv_conventions.checks import message

BROKEN = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    pickle.UnpicklingError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
"""What a damaged archive makes its reader raise, whichever part of it is hit."""


def require_sums(path: Path) -> None:
    """Compare the checksums in an archive: a changed bit is another number.

    Neither torch does so, nor numpy before it has read a part to its end.

    Raises:
        BadZipFile: A part is not what was written.
    """
    if not zipfile.is_zipfile(path):
        return
    with zipfile.ZipFile(path) as archive:
        changed = archive.testzip()
    if changed is not None:
        raise zipfile.BadZipFile(f"a wrong checksum of {changed}")


@contextmanager
def opened_arrays(path: Path) -> Iterator[NpzFile]:
    """Arrays by name in a file of `numpy.savez`, all of which are as they were written.

    Raises:
        ValueError: The file is missing or damaged, or lacks what is read.
    """
    try:
        require_sums(path)
        with np.load(path, allow_pickle=False) as stored:
            yield stored
    except BROKEN as broken:
        found = str(broken) or type(broken).__name__
        remedy = "Delete it, and give the command that wrote it again."
        told = message("file", "hold arrays as they were written", found, f"in {path}", remedy)
        raise ValueError(told) from broken
