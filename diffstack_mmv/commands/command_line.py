"""The words of a command line, put as Hydra understands them."""

import os
import re
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

NEW_FOLDER = "${new_folder:"
"""Begins a folder that is to be a new one."""


def understood(arguments: Sequence[str], name: str) -> list[str]:
    """Command line as Hydra understands it.

    Options stand at the end, a sweep (`-m`) has a folder, `~` is the home folder, and the file of a
    vehicle is one.

    Args:
        arguments: The command line without its first word.
        name: Name of the command.
    """
    words = _options_last(_sweep_in_folder(arguments, name))
    return _of_its_file(_last_vehicle([_vehicle_from_file(_at_home(each)) for each in words]))


def _options_last(arguments: Sequence[str]) -> list[str]:
    """Move options of Hydra to the end: overrides on both sides of one would not be understood."""
    overrides, options = [], []
    for before, each in zip(["", *arguments], arguments, strict=False):
        follows = before in _WITH_A_VALUE and not (before in _ALONE_AS_WELL and "=" in each)
        (options if each.startswith("-") or follows else overrides).append(each)
    return [*overrides, *options]


def _sweep_in_folder(arguments: Sequence[str], name: str) -> list[str]:
    """Give a sweep its folder: Hydra resolves it before it knows the name of the command."""
    sweeping = any(each in ("-m", "--multirun", "hydra.mode=MULTIRUN") for each in arguments)
    given = any(each.startswith(("out=", "hydra.sweep.dir=")) for each in arguments)
    folder = f"{NEW_FOLDER}outputs/{name}/{datetime.now():%Y-%m-%d_%H-%M-%S}}}"
    return [*arguments, f"out={folder}"] if sweeping and not given else list(arguments)


_WITH_A_VALUE = (
    *("--cfg", "-c", "--package", "-p", "--config-path", "-cp", "--config-name", "-cn"),
    *("--config-dir", "-cd", "--info", "-i", "--experimental-rerun"),
)
"""Options of Hydra that the next word belongs to."""
_ALONE_AS_WELL = ("--info", "-i")


def quoted(path: Path | str) -> str:
    """A path as the value of a setting: without quotes Hydra takes neither brackets nor umlauts."""
    # a quote is escaped, and so are the backslashes before one
    text = re.sub(r"(\\*)('|$)", r"\1\1\2", str(path)).replace("'", "\\'")
    return f"'{text}'"


def folders_as(key: str, arguments: Sequence[str]) -> list[str]:
    """Command line in which bare folders, as in `report.py RUN RUN`, are the list of one key.

    What begins with a dash or sets a key stays, unless it is a folder of that name; so does the
    word after an option of Hydra that needs one, as in `--cfg job`.

    Args:
        key: The key.
        arguments: The command line without its first word.
    """
    bare, rest = [], []
    for before, each in zip(["", *arguments], arguments, strict=False):
        of_hydra = before in _WITH_A_VALUE
        (bare if _is_folder(each) and not of_hydra else rest).append(each)
    listed = ",".join(quoted(each) for each in bare)
    return [*rest, f"{key}=[{listed}]"] if bare else rest


def _is_folder(argument: str) -> bool:
    named = not argument.startswith("-") and "=" not in argument
    return named or Path(argument).is_dir()


_IN_HOME = re.compile(
    r"(?<=[=\[,:])(?P<blank> *)(?P<quote>['\"]?)(?P<path>~(/[^'\",\[\]{}]*?)?)(?P=quote)"
    r"(?= *(?:[,\]}]|$))"
)


def _at_home(argument: str) -> str:
    """`out=~/runs` is in the home folder: shells leave a `~` within a word as it is.

    So is `~/b` in `runs=[~/a,~/b]`, which Hydra cannot read.
    """

    def expanded(found: re.Match[str]) -> str:
        path = os.path.expanduser(found["path"])
        return found[0] if path[0] == "~" else f"{found['blank']}{quoted(path)}"

    return _IN_HOME.sub(expanded, argument)


_FILE = "vehicle_file="


def _vehicle_from_file(argument: str) -> str:
    """`vehicle=NAME` selects an option of a group, as Hydra knows it.

    `vehicle=FILE.yaml` becomes `vehicle_file=FILE.yaml`.
    """
    bare = argument.rstrip("'\"")  # a path with blanks or brackets stands in quotes
    is_file = bare.startswith("vehicle=") and bare.endswith((".yaml", ".yml"))
    return argument.replace("vehicle=", _FILE, 1) if is_file else argument


def _last_vehicle(words: Sequence[str]) -> list[str]:
    """Of several values of a key the last one holds, also where a name follows upon a file."""
    last = max((n for n, each in enumerate(words) if each.startswith("vehicle=")), default=-1)
    return [each for n, each in enumerate(words) if n > last or not each.startswith(_FILE)]


def _of_its_file(words: Sequence[str]) -> list[str]:
    """Keys of a vehicle in a file, which Hydra does not know: it composes another vehicle.

    What the vehicle itself does not know is refused by it.
    """
    in_file = any(each.startswith(_FILE) for each in words)
    return [f"++{each}" if in_file and each.startswith("vehicle.") else each for each in words]
