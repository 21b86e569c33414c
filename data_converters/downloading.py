"""Large files from the web: resumable, verified, unpacked whole or not at all."""

from __future__ import annotations

import hashlib
import http.client
import logging
import os
import shutil
import urllib.error
import urllib.request
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from data_converters.archives import whole_tar
from data_converters.errors import ConversionError, require

logger = logging.getLogger(__name__)

CHUNK = 1 << 20
TIMEOUT_S = 60.0


class DownloadError(ConversionError):
    """A file could not be fetched, verified or unpacked."""


@dataclass(frozen=True)
class RemoteFile:
    """A file of the record: name, size in bytes, MD5 sum, address."""

    name: str
    size: int
    md5: str
    url: str


def fetch(file: RemoteFile, folder: Path, *, attempts: int, progress: bool) -> Path:
    """Fetch one file into `folder`; it carries its name only when size and checksum are right.

    Raises:
        DownloadError: If all attempts end early, or the checksum is wrong.
    """
    target, partial = folder / file.name, folder / f"{file.name}.part"
    if target.is_file() and _md5(target) == file.md5:
        return target
    problem: Exception | str = "nothing"
    for _ in range(attempts):
        if _size(partial) >= file.size:
            break
        try:
            _continue(file, partial, progress=progress)
        except (
            urllib.error.URLError,
            http.client.HTTPException,
            ConnectionError,
            TimeoutError,
        ) as error:
            problem = error
            logger.warning("%s broke off at %d bytes: %s", file.name, _size(partial), error)
    found = f"{_size(partial)} after {attempts} attempts ({problem})"
    needs, remedy = f"have {file.size} bytes", "Run it again: it goes on where it stopped."
    require(_size(partial) >= file.size, file.name, needs, found, file.url, remedy, DownloadError)
    found = _md5(partial)
    if found != file.md5:
        partial.unlink()
    needs, remedy = f"have the MD5 sum {file.md5}", "The damaged file was removed; run it again."
    require(found == file.md5, file.name, needs, found, file.url, remedy, DownloadError)
    os.replace(partial, target)
    return target


def _continue(file: RemoteFile, partial: Path, *, progress: bool) -> None:
    """Append what is missing; start over if the server cannot send a range."""
    done = _size(partial)
    request = urllib.request.Request(file.url, headers={"Range": f"bytes={done}-"} if done else {})
    with urllib.request.urlopen(request, timeout=TIMEOUT_S) as response:
        if response.status != http.HTTPStatus.PARTIAL_CONTENT:
            done = 0
        bar = tqdm(
            total=file.size,
            initial=done,
            unit="B",
            unit_scale=True,
            desc=file.name,
            disable=not progress,
        )
        with bar, partial.open("ab" if done else "wb") as stream:
            while block := response.read(CHUNK):
                stream.write(block)
                bar.update(len(block))


def unpack(archive: Path, folder: Path) -> None:
    """Unpack an archive; `folder` appears when everything is in it.

    Raises:
        DownloadError: If the archive is broken or reaches outside its folder.
    """
    partial = folder.with_name(f".unpacking_{folder.name}")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        with whole_tar(archive, error=DownloadError) as tar:
            tar.extractall(partial, filter="data")
        os.replace(partial, folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0


def _md5(path: Path) -> str:
    digest = hashlib.md5(usedforsecurity=False)
    with path.open("rb") as stream:
        while block := stream.read(CHUNK):
            digest.update(block)
    return digest.hexdigest()
