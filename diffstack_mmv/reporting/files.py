"""Writing result files all or nothing."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically, making its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(path.name + ".part")
    unfinished.write_text(text, encoding="utf-8")
    unfinished.replace(path)


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
    except json.JSONDecodeError as broken:
        raise ValueError(f"`{path}` must be JSON, but got: {broken}. Write it anew.") from broken
    if not isinstance(content, dict):
        raise ValueError(f"`{path}` must hold a JSON object, but got {type(content).__name__}.")
    return content


def write_parquet(path: Path, frame: pd.DataFrame) -> None:
    """Write a table as Parquet atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(path.name + ".part")
    frame.to_parquet(unfinished)
    unfinished.replace(path)


def read_parquet(path: Path) -> pd.DataFrame:
    """Read a Parquet table.

    Raises:
        ValueError: The file is missing.
    """
    if not path.is_file():
        raise ValueError(
            f"`{path}` must exist, but there is no such file. Run the step that writes it."
        )
    return pd.read_parquet(path)
