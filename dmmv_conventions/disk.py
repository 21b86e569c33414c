"""Files on disk: written all or nothing, and failures for want of space."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

UNFINISHED = ".part"
"""Among the endings of a file that is being written; who is killed leaves it behind."""


def disk_is_full(error: OSError) -> bool:
    """Whether no space, or no quota, is left, or a file may not be as large (`ulimit -f`)."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def replacing(path: Path, ending: str = UNFINISHED) -> Iterator[Path]:
    """Write a file all or nothing: a reader sees the old one or the whole new one.

    What is written beside it takes its place at the end; if the body fails, it is removed and the
    old file stays.

    Args:
        path: File to write; its folder is made.
        ending: What the name of the unfinished file ends with, for writers that go by the ending.

    Yields:
        Where to write.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(path.name + ending)
    try:
        yield unfinished
        os.replace(unfinished, path)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise
