"""How the data sets of `configs/data` are called in a cache, and by which settings."""

import re
from collections.abc import Iterator, Mapping
from functools import cache as remembered
from typing import Any

from dmmv_conventions.checks import require
from dmmv_conventions.configs import config_folder

TABLES = "csv"
"""Data set of tables of one's own, which has any name."""

_NAME = re.compile(r"^name: (\S+)", re.MULTILINE)
_CONVERTER = re.compile(r"^recordings:\n +_target_: (\S+)", re.MULTILINE)
_SETTING = re.compile(r"\$\{([\w.]+)\}")


@remembered
def choice_of(name: str) -> str:
    """The settings that choose a data set by its name; one that none is called is tables."""
    known = (
        " ".join([f"data={data}", *settings])
        for data, text in _converted()
        if (settings := _settings_of(name, text)) is not None
    )
    return next(known, f"data={TABLES} data.name={name}")


def family_of(name: str) -> str:
    """The data set whose recordings a name holds, as eth_ucy of eth_ucy_hotel; else the name."""
    data, _, settings = choice_of(name).removeprefix("data=").partition(" ")
    return data if settings and data != TABLES else name


def require_name_of_converter(data: Any) -> None:
    """Refuse a name under which a converter writes nothing: only tables have one of their own.

    Args:
        data: Configuration of a data set, resolved, as plain containers; one without a converter
            of `configs/data` may have any name.

    Raises:
        ValueError: The conversion would be written under another name, or is looked for there.
    """
    recordings = data.get("recordings") if isinstance(data, Mapping) else None
    if not isinstance(recordings, Mapping):
        return
    for choice, text in _converted():
        if choice != TABLES and _CONVERTER.findall(text) == [recordings.get("_target_")]:
            name = str(data.get("name"))
            own = _settings_of(name, text) is not None
            needs = f"be {_NAME.findall(text)[0]}, as data={choice} is always called"
            remedy = f"Leave it out; tables alone (data={TABLES}) have names of their own."
            require(own, "data.name", needs, repr(name), "", remedy)


def _converted() -> Iterator[tuple[str, str]]:
    """Option and text of every data set that has a converter of ours."""
    for file in sorted((config_folder() / "data").glob("*.yaml")):
        text = file.read_text(encoding="utf-8")
        if _CONVERTER.search(text) is not None:
            yield file.stem, text


def _settings_of(name: str, text: str) -> list[str] | None:
    """The settings with which the data set of a text is called so, None if it never is."""
    parts = _SETTING.split(_NAME.findall(text)[0])  # text and names of settings by turns
    found = re.fullmatch("(.+)".join(map(re.escape, parts[::2])), name)
    if found is None:
        return None
    return [f"{key}={value}" for key, value in zip(parts[1::2], found.groups(), strict=True)]
