"""Archives as they have to be: whole to the last byte, and of a bounded size."""

from __future__ import annotations

import gzip
import tarfile
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO

from data_converters.errors import ConversionError, fault, require
from dmmv_conventions.disk import disk_is_full

BLOCK = 512
LARGEST_BYTES = 1 << 38
"""Unpacked size above which an archive is refused."""

_BROKEN = (tarfile.TarError, EOFError, OSError, zlib.error, LookupError, RecursionError, ValueError)


@contextmanager
def whole_tar(
    archive: Path, largest: int = LARGEST_BYTES, error: type[ConversionError] = ConversionError
) -> Iterator[tarfile.TarFile]:
    """Open an archive after all of it has been read once: checksum, length and closing blocks.

    tarfile itself takes an archive that is cut off between two files, or whose checksum is wrong,
    as if it were whole.

    Args:
        archive: A tar file, compressed with gzip or not at all.
        largest: Largest unpacked size in bytes.
        error: Class of the error.

    Raises:
        ConversionError: The archive is cut off, damaged, too large or no archive; of class `error`.
    """
    remedy = "Copy or download the archive again."
    try:
        with tempfile.TemporaryFile() as unpacked:
            size = _unpack(archive, unpacked, largest)
            needs = f"unpack to at most {largest} bytes"
            require(size <= largest, "archive", needs, "more", archive, remedy, error)
            found = "no closing blocks, so that its end is missing"
            require(_is_closed(unpacked, size), "archive", "be whole", found, archive, "", error)
            with tarfile.open(fileobj=unpacked, mode="r:") as tar:
                yield tar
    except _BROKEN as broken:
        if isinstance(broken, ConversionError) or (
            isinstance(broken, OSError) and disk_is_full(broken)
        ):
            raise
        raise error(f"{fault('archive', 'be whole', broken, archive, remedy)}") from broken


def _unpack(archive: Path, target: IO[bytes], largest: int) -> int:
    """Decompress to a file; reading to the end is what checks the checksum of gzip."""
    with archive.open("rb") as raw:
        packed = raw.read(2) == b"\x1f\x8b"
        raw.seek(0)
        with gzip.GzipFile(fileobj=raw) if packed else raw as source:
            while target.tell() <= largest and (block := source.read(1 << 20)):
                target.write(block)
    return target.tell()


def _is_closed(unpacked: IO[bytes], size: int) -> bool:
    """Whether an archive ends with two blocks of zeros, as all do."""
    unpacked.seek(max(size - 2 * BLOCK, 0))
    closing = unpacked.read()
    unpacked.seek(0)
    return size > 2 * BLOCK and size % BLOCK == 0 and not any(closing)


def reaches_outside(name: str) -> bool:
    """Whether the name of a member is absolute or leads above its folder."""
    path = PurePosixPath(name.replace("\\", "/"))
    return path.is_absolute() or ".." in path.parts
