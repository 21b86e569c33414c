"""Which code made a result."""

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = ("diffstack_mmv", "dmmv_conventions")
_SOURCES = (".py", ".hpp")
"""Endings of what runs: the libraries in C++ are built from headers."""


@cache
def code_version() -> str:
    """Version of the package and a hash of its sources, in a checkout as where it is installed."""
    return f"{installed_version()}+{sources_hash(Path(__file__).resolve().parents[1])}"


def sources_hash(root: Path) -> str:
    """Hash of names and contents of the sources in the folder of the packages, 16 digits."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*")):
            if path.suffix in _SOURCES:
                digest.update(path.relative_to(root).as_posix().encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def installed_version() -> str:
    """Version of the installed package, `unknown` where it is not installed."""
    try:
        return version("diffstack_mmv")
    except PackageNotFoundError:
        return "unknown"


def file_hash(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
