"""Download of IMPTC from its public record: resumable, verified, unpacked whole or not at all."""

from __future__ import annotations

import hashlib
import http.client
import json
import logging
import os
import re
import shutil
import urllib.error
import urllib.request
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from tqdm import tqdm

from data_converters.archives import whole_tar
from data_converters.errors import ConversionError, fault, require
from dmmv_conventions.disk import disk_is_full

logger = logging.getLogger(__name__)

RECORD_URL = "https://zenodo.org/api/records/14811016"
"""The record of IMPTC; names, sizes and MD5 sums of the files are read from it."""

CHUNK = 1 << 20
TIMEOUT_S = 60.0


class Part(StrEnum):
    """A part of the data set: four sample sequences, all sequences, or the VRU release."""

    SAMPLE = "sample"
    SEQUENCES = "sequences"
    VRU = "vru"


PART_FILES = {
    Part.SAMPLE: re.compile(r"imptc_samples?\b.*"),
    Part.SEQUENCES: re.compile(r"imptc_set_\d+\b.*"),
    Part.VRU: re.compile(r"imptc_trajectory\w*\b.*"),
}


class DownloadError(ConversionError):
    """A file could not be fetched, verified or unpacked."""


@dataclass(frozen=True)
class RemoteFile:
    """A file of the record: name, size in bytes, MD5 sum, address."""

    name: str
    size: int
    md5: str
    url: str


def download_imptc(
    out: Path,
    parts: Sequence[Part] = (Part.SAMPLE,),
    *,
    record_url: str = RECORD_URL,
    attempts: int = 5,
    keep_archives: bool = False,
    progress: bool = True,
) -> list[Path]:
    """Fetch and unpack parts of IMPTC; run it again to go on where it stopped.

    Args:
        out: Folder that gets one folder per archive.
        parts: What to fetch.
        record_url: Address of the record.
        attempts: Connections to try per file; each goes on where the last one broke.
        keep_archives: Whether archives stay after unpacking.
        progress: Whether to show a progress bar.

    Returns:
        The unpacked folders.

    Raises:
        DownloadError: If the record or a file cannot be fetched, a checksum is wrong, an archive is
            broken or the disk is full.
    """
    out.mkdir(parents=True, exist_ok=True)
    wanted = _wanted(read_record(record_url), parts, record_url)
    folders = []
    try:
        for file in wanted:
            folder = out / file.name.partition(".")[0]
            if not folder.is_dir():
                archive = fetch(file, out, attempts=attempts, progress=progress)
                unpack(archive, folder)
                if not keep_archives:
                    archive.unlink()
            folders.append(folder)
    except OSError as error:
        if not disk_is_full(error):
            raise
        remedy = "Free space and run it again: it goes on where it stopped."
        raise DownloadError(fault("out", "have free disk space", error, out, remedy)) from error
    return folders


def read_record(url: str) -> list[RemoteFile]:
    """Files of a Zenodo record.

    Raises:
        DownloadError: If the record cannot be read or does not state MD5 sums.
    """
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT_S) as response:
            entries = json.load(response)["files"]
        return [
            RemoteFile(
                name=entry["key"],
                size=int(entry["size"]),
                md5=entry["checksum"].removeprefix("md5:"),
                url=entry["links"]["self"],
            )
            for entry in entries
        ]
    except (OSError, http.client.HTTPException, KeyError, TypeError, ValueError) as error:
        remedy = "Check the connection, or give `record_url`."
        requirement = "be a readable record with files, sizes and MD5 sums"
        raise DownloadError(fault("record_url", requirement, error, url, remedy)) from error


def _wanted(files: list[RemoteFile], parts: Sequence[Part], url: str) -> list[RemoteFile]:
    wanted = []
    for part in parts:
        matching = [file for file in files if PART_FILES[part].fullmatch(file.name)]
        needs, found = f"be in the record ('{part}')", [file.name for file in files]
        remedy = "The record has changed; see `PART_FILES`."
        require(bool(matching), "parts", needs, found, url, remedy, DownloadError)
        wanted += matching
    return wanted


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
