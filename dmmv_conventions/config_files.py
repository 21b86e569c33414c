"""Files of a configuration group, composed and built without Hydra, which the core does not need.

They are the files that the command lines compose. A file names what is built by `_target_`, and may
build on others beside it (`defaults`).
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from dmmv_conventions.checks import message, require, require_one_of
from dmmv_conventions.yaml_files import load_plain

SELF = "_self_"


def names_in(folder: Path) -> list[str]:
    """Names of the files of a group, sorted."""
    return sorted(path.stem for path in folder.glob("*.yaml"))


def settings_of(name: str, folder: Path) -> dict[str, Any]:
    """Settings of one file over those of the files it builds on, as Hydra composes them.

    A base `NAME@KEY` stands under that key. Options of other groups are told by `chosen_in`.

    Args:
        name: Name of the file without its ending.
        folder: The folder of the file and of those it builds on; its name is that of the group.

    Returns:
        Plain values; interpolations as they are written, but for those within the file (`${.x}`).

    Raises:
        ValueError: There is no such file, nothing where an interpolation within it points, or one
            leads back to itself.
    """
    settings = _layered(name, folder)
    return _with_relatives(settings, [settings])


def chosen_in(name: str, folder: Path) -> dict[str, str]:
    """Options of other groups that a file chooses (`override /GROUP@...: NAME`), by group."""
    bases = _content(name, folder).get("defaults", [])
    overrides = [each for base in bases if isinstance(base, Mapping) for each in base.items()]
    return {key.removeprefix("override /").partition("@")[0]: option for key, option in overrides}


def _layered(name: str, folder: Path) -> dict[str, Any]:
    """Settings of one file over those of the files it builds on."""
    content = _content(name, folder)
    bases = [base for base in content.pop("defaults", []) if not isinstance(base, Mapping)]
    settings: dict[str, Any] = {}
    for base in bases if SELF in bases else [*bases, SELF]:
        sibling, _, key = base.partition("@")
        below = content if base == SELF else _layered(sibling, folder)
        settings = _merged(settings, {key: below} if key else below)
    return settings


def _with_relatives(
    content: Any, holders: Sequence[Any], followed: Sequence[tuple[int, str]] = ()
) -> Any:
    """Settings in which `${.x}` is the neighbour x, and each further dot is one level up.

    Args:
        content: Some of the settings.
        holders: All settings, what lies in them on the way to these, and these.
        followed: Where the interpolations point that led to these: a holder and a key in it each.

    Raises:
        ValueError: There is no such neighbour, or what it is depends on itself.
    """
    if isinstance(content, Mapping):
        return {k: _with_relatives(v, [*holders, v], followed) for k, v in content.items()}
    if isinstance(content, list):
        return [_with_relatives(value, [*holders, value], followed) for value in content]
    found = re.fullmatch(r"\$\{(\.+)([\w.]+)\}", content) if isinstance(content, str) else None
    if found is None or len(found[1]) >= len(holders):
        return content
    path = list(holders[: -len(found[1])])
    for key in found[2].split("."):
        inside = isinstance(path[-1], Mapping) and key in path[-1]
        require(inside, "settings", "hold what their interpolations name", repr(content))
        path.append(path[-1][key])
    place = id(path[-2]), found[2].rpartition(".")[2]
    needs = "hold no interpolation that leads back to itself"
    require(place not in followed, "settings", needs, repr(content))
    return _with_relatives(path[-1], path, (*followed, place))


def _content(name: str, folder: Path) -> dict[str, Any]:
    require_one_of(folder.name, name, names_in(folder))
    return load_plain((folder / f"{name}.yaml").read_text(encoding="utf-8"))


def factory(settings: Mapping[str, Any], given: Mapping[str, Any] | None = None) -> partial[Any]:
    """What builds the `_target_` of some settings, with everything inside built already.

    Args:
        settings: A mapping with `_target_`.
        given: What stands for the interpolations `${name}`, or `${name:...}`, by their names.

    Raises:
        ValueError: An interpolation is not given; in a command line, others of its keys are.
    """
    arguments = {
        key: _built(value, key, given or {}) for key, value in settings.items() if key[:1] != "_"
    }
    return partial(resolve_name(settings["_target_"]), **arguments)


def interpolations(settings: Any) -> Iterator[str]:
    """Names of what some settings leave to others: `model` for `${model}`."""
    if isinstance(settings, Mapping):
        for value in settings.values():
            yield from interpolations(value)
    elif isinstance(settings, list):
        for value in settings:
            yield from interpolations(value)
    elif isinstance(settings, str) and "${" in settings:
        yield _name_in(settings) or settings


def _merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of `above` over those of `below`, mapping by mapping."""
    merged = dict(below)
    for key, value in above.items():
        both = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = _merged(merged[key], value) if both else value
    return merged


def _built(content: Any, place: str, given: Mapping[str, Any]) -> Any:
    if isinstance(content, Mapping):
        if "_target_" in content:
            build = factory(content, given)
            return build if content.get("_partial_") else build()
        return {key: _built(value, f"{place}.{key}", given) for key, value in content.items()}
    if isinstance(content, list):
        return [_built(value, place, given) for value in content]
    if not (isinstance(content, str) and "${" in content):
        return content
    name = _name_in(content)
    if name not in given:
        remedy = "Write the value, or use the command line, which knows it."
        raise ValueError(message(place, "be a plain value", repr(content), "", remedy))
    return given[name]


def _name_in(content: str) -> str:
    """The name of an interpolation `${name}` or `${name:...}`, "" of anything else."""
    found = re.match(r"\$\{([\w.]+)[:}]", content)
    return found[1] if found else ""
