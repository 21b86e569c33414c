"""Download of IMPTC from its public record."""

from __future__ import annotations

import http.client
import json
import re
import urllib.error
import urllib.request
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path

from data_converters.downloading import TIMEOUT_S, DownloadError, RemoteFile, fetch, unpack
from data_converters.errors import fault, require
from dmmv_conventions.disk import disk_is_full

RECORD_URL = "https://zenodo.org/api/records/14811016"
"""The record of IMPTC; names, sizes and MD5 sums of the files are read from it."""


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
