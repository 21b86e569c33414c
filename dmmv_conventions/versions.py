"""Which code made a result."""

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = ("diffstack_mmv", "dmmv_conventions")


@cache
def code_version() -> str:
    """Version of the package and a hash of its sources, in a checkout as where it is installed."""
    digest = hashlib.sha256()
    root = Path(__file__).resolve().parents[1]
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode())
            digest.update(path.read_bytes())
    return f"{installed_version()}+{digest.hexdigest()[:16]}"


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
