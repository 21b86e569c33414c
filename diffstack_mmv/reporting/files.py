"""Writing result files all or nothing."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd
from pyarrow.lib import ArrowException

from dmmv_conventions.disk import replacing
from dmmv_conventions.yaml_files import read_plain


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically, making its folder."""
    with replacing(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file atomically; NaN is refused, so that any reader can read it.

    Raises:
        ValueError: A number is NaN or infinite.
    """
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def write_compact(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file that is read by programs only, without white space, atomically.

    Raises:
        ValueError: A number is NaN or infinite.
    """
    write_text(path, json.dumps(content, separators=(",", ":"), allow_nan=False))


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file.

    Raises:
        ValueError: The file is missing or no JSON object.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as missing:
        raise ValueError(
            f"`{path}` must exist, but there is no such file. Run the step that writes it."
        ) from missing
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as broken:
        raise ValueError(f"`{path}` must be JSON, but got: {broken}. Write it anew.") from broken
    if not isinstance(content, dict):
        raise ValueError(f"`{path}` must hold a JSON object, but got {type(content).__name__}.")
    return content


def read_config(folder: Path) -> dict[str, Any]:
    """The configuration of a run, empty where its folder holds none.

    Raises:
        ValueError: The file is no YAML, or no mapping.
    """
    file = folder / "config.yaml"
    return read_plain(file, file.name) if file.is_file() else {}


def write_parquet(path: Path, frame: pd.DataFrame) -> None:
    """Write a table as Parquet atomically."""
    with replacing(path) as unfinished:
        frame.to_parquet(unfinished)


def read_parquet(path: Path) -> pd.DataFrame:
    """Read a Parquet table.

    Raises:
        ValueError: The file is missing or broken.
    """
    if not path.is_file():
        raise ValueError(
            f"`{path}` must exist, but there is no such file. Run the step that writes it."
        )
    with told_as_broken(path):
        return pd.read_parquet(path)


# what pandas and our readers raise where a file holds something else than was written
_BROKEN = (ArithmeticError, ArrowException, AttributeError, LookupError, TypeError, ValueError)


@contextmanager
def told_as_broken(place: Path) -> Iterator[None]:
    """Tell what goes wrong while results are read as the fault of their file or folder.

    Raises:
        ValueError: They are not as this version writes them.
    """
    try:
        yield
    except _BROKEN as broken:
        if isinstance(broken, ValueError) and str(broken).startswith("`"):
            raise  # says already what is wrong
        told = f"{type(broken).__name__}: {broken}".splitlines()[0]
        raise ValueError(
            f"`{place}` must be as this version writes it, but got {told}. Run the step that "
            "writes it again."
        ) from broken
