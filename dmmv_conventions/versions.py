"""Which code made a result."""

import hashlib
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from dmmv_conventions.targets import trusted_packages

_PACKAGES = ("diffstack_mmv", "dmmv_conventions")
_SOURCES = (".py", ".hpp")
"""Endings of what runs: the libraries in C++ are built from headers."""


@cache
def code_version() -> str:
    """Version of the package and a hash of its sources, in a checkout as where it is installed.

    The sources of packages of one's own that files may name count as well.
    """
    root = Path(__file__).resolve().parents[1]
    places = [root / package for package in _PACKAGES]
    own = [place for package in trusted_packages() for place in _places(package)]
    return f"{installed_version()}+{sources_hash([*places, *own])}"


def sources_hash(places: Iterable[Path]) -> str:
    """Hash of names and contents of the sources in folders of packages, or in files; 16 digits."""
    digest = hashlib.sha256()
    for place in places:
        for path in [place] if place.is_file() else sorted(place.rglob("*")):
            if path.suffix in _SOURCES:
                digest.update(path.relative_to(place.parent).as_posix().encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _places(package: str) -> list[Path]:
    """Folders of a package, or the file of a module; none where it is not installed."""
    found = find_spec(package.partition(".")[0])
    if found is None:
        return []
    folders = found.submodule_search_locations
    return [Path(each) for each in folders or [found.origin] if each]


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
