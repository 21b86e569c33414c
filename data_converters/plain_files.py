"""What a recording may lie in: plain files of a bounded size.

A pipe would be waited for without end, and a file of zeros, or one that unpacks to them, would fill
the memory.
"""

from __future__ import annotations

import gzip
import stat
import zlib
from pathlib import Path

from data_converters.errors import RejectReason, refuse_track

LARGEST_BYTES = 1 << 31
"""Size, unpacked, above which a file of recordings is refused."""


def require_plain(path: Path, largest: int = LARGEST_BYTES) -> None:
    """Refuse what is no plain file, or larger than any recording; a link counts as its target.

    Args:
        path: The file; the size of one that ends in ".gz" is that of its content.
        largest: Largest size in bytes.

    Raises:
        TrackError: It is a folder, a pipe, a device or too large.
        OSError: There is none, or it may not be read.
    """
    found, reason = path.stat(), RejectReason.UNREADABLE
    if not stat.S_ISREG(found.st_mode):
        kind = "a folder" if stat.S_ISDIR(found.st_mode) else "a pipe or a device"
        refuse_track(reason, "file", "be a plain file", kind, path, "Copy the file again.")
    size = _unpacked(path, largest) if path.suffix == ".gz" else found.st_size
    if size > largest:
        remedy = "Copy the file again, or cut it into parts."
        refuse_track(reason, "file", f"have at most {largest} bytes", "more", path, remedy)


def _unpacked(path: Path, largest: int) -> int:
    """Size of the content as far as it can be read, no further than `largest` is exceeded."""
    size = 0
    try:
        with gzip.open(path) as source:
            while size <= largest and (block := source.read(1 << 20)):
                size += len(block)
    except (gzip.BadGzipFile, EOFError, zlib.error):
        pass  # who reads the content tells it
    return size
