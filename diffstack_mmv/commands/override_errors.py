"""What is wrong with a command line that Hydra cannot compose, told in one line."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dmmv_conventions.checks import alike, did_you_mean, message
from dmmv_conventions.config_files import names_in

PLACE = "on the command line"
_ALL_KEYS = "`--cfg job` prints all keys."
_EXTRAS = {"hydra/sweeper/optuna": "sweep", "hydra/launcher/submitit": "sweep"}
_UNKNOWN_KEY = re.compile(r"Could not (?:override|delete from config\.|delete) '?([^'\s]+)'")
_NO_CHOICE = re.compile(r"You must specify '(\S+)',.*?Available options:(.*)", re.DOTALL)
_NOT_MERGED = re.compile(r"Error merging override ([^=\s]+)=")
_NO_NAME = "Config group override must be a string or a list."
_TWICE = re.compile(r"Multiple values for (\S+)\.")


def told(
    error: HydraException | OmegaConfBaseException | ValueError,
    arguments: Sequence[str],
    folder: Path,
    config_name: str,
) -> str:
    """One line for an error of Hydra's composition.

    Args:
        error: What Hydra raised.
        arguments: The command line without its first word.
        folder: The folder of the configuration groups.
        config_name: File in it, without its ending.

    Returns:
        What is wrong, where, and what to do.
    """
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        if "/" not in error.missing_cfg_file:
            return message("config-name", f"be {config_name}", error.missing_cfg_file, PLACE)
        return _unknown_option(error.missing_cfg_file, error.options or ())
    if isinstance(error, OverrideParseException):
        remedy = (
            "Write key=value, and put values with brackets, commas, blanks or letters such as ü in "
            "quotes that the shell leaves: \"out='...'\"."
        )
        return message("arguments", "read key=value", repr(error.override), PLACE, remedy)
    if found := _TWICE.match(str(error)):
        given = _given(found[1], arguments)
        return message(found[1], "be given once", given, PLACE, "Leave out the `+`.")
    if found := _NO_CHOICE.match(str(error)):
        return f"`{found[1]}` must be given. Add {found[1]}=NAME: {', '.join(found[2].split())}."
    if found := _NOT_MERGED.match(str(error)):
        bare = found[1].lstrip("+~")
        needs = "have a value of the kind of its default, such as settings with their names"
        return message(bare, needs, _given(bare, arguments), PLACE, "`--cfg job` prints it.")
    if isinstance(error, ValueError) and str(error).startswith(_NO_NAME):
        return _no_option(error, arguments, folder)
    if found := _UNKNOWN_KEY.match(str(error)):
        return _unknown_key(found[1], arguments, folder, config_name)
    return one_line(str(error))


def one_line(text: str) -> str:
    """The words of a text, however it was broken into lines."""
    return " ".join(text.split())


def told_of_folder(error: OSError) -> str:
    """The message for an output folder that cannot be made."""
    found = f"{error.filename!r} ({error.strerror})"
    return message("out", "be a folder that can be written", found, "", "Give another one.")


def told_of_access(error: PermissionError, out: str) -> str:
    """The message for a file that may not be read or written.

    Args:
        error: The failure.
        out: Folder of the run, where most is written.
    """
    if error.filename is None:
        return one_line(str(error))
    if Path(error.filename).absolute().is_relative_to(Path(out).absolute()):
        return told_of_folder(error)
    found = f"{str(error.filename)!r} ({error.strerror})"
    return message("path", "be open to this user", found, "", "Allow it, or give another one.")


def told_of_disk(error: OSError, out: str) -> str:
    """The message for a disk that is full; a file is told only where it was opened.

    Args:
        error: The failure; what told it already in words of its own stays.
        out: Folder of the run, where most is written.
    """
    said = str(error.strerror)
    remedy = "Free space, or raise your limit, and give the same command again."
    where = f"at {error.filename or out}"
    told = message("disk", "have free space", said, where, remedy)
    return one_line(said) if said.startswith("`") else told


def _unknown_option(file: str, options: Sequence[str]) -> str:
    group, _, name = file.rpartition("/")
    extra = next((_EXTRAS[begin] for begin in _EXTRAS if file.startswith(begin)), None)
    close = alike(name, options, 2, 0.5)
    remedy = f"Did you mean {group}={' or '.join(close)}?" if close else ""
    if extra is not None:
        remedy = f"Install it: pip install 'diffstack_mmv[{extra}]'."
    elif group == "vehicle":
        remedy = f"{remedy} A vehicle of your own is the path of a YAML file.".lstrip()
    return message(group, f"be one of {', '.join(options)}", repr(name), PLACE, remedy)


def _no_option(error: ValueError, arguments: Sequence[str], folder: Path) -> str:
    """The message for a group that is given a number, a truth value or null."""
    groups = (each for each in arguments if _key_of(each) and (folder / _key_of(each)).is_dir())
    for word in groups:
        given = OverridesParser.create().parse_override(word)
        if given.is_delete() or isinstance(given.value(), str | list):
            continue
        group, value = given.key_or_group, "null" if given.value() is None else given.value()
        wanted = f"be one of {', '.join(names_in(folder / group))}"
        return message(group, wanted, value, PLACE, "Leave it out for the default.")
    return one_line(str(error))


def _unknown_key(key: str, arguments: Sequence[str], folder: Path, config_name: str) -> str:
    bare = key.lstrip("+~")
    keys = list(_keys(bare, arguments, folder, config_name))
    if bare in keys:
        remedy = f"Write ~{bare} '+{bare}={{...}}' to replace it whole."
        given = _given(bare, arguments)
        return message(bare, "hold no other keys than it has", given, PLACE, remedy)
    last = [each for each in keys if each.rpartition(".")[2] == bare.rpartition(".")[2]]
    meant = did_you_mean(bare, last, "`", 0.0) or did_you_mean(bare, keys, "`")
    remedy = f"{meant} {_ALL_KEYS}".lstrip()
    wanted = f"be a key of the configuration of {config_name}"
    return message(bare, wanted, _given(bare, arguments), PLACE, remedy)


def _keys(bad: str, arguments: Iterable[str], folder: Path, config_name: str) -> Iterator[str]:
    """All dotted keys of a configuration, with the groups that the command line chooses."""
    groups = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_dir()}
    chosen = [
        each
        for each in arguments
        if _key_of(each) in groups and "," not in each and "~" not in each
    ]
    for overrides in (chosen, []):
        GlobalHydra.instance().clear()
        try:
            with initialize_config_dir(str(folder), version_base="1.3"):
                config = compose(config_name, overrides)
        except (HydraException, OmegaConfBaseException):
            continue
        yield from _dotted("", OmegaConf.to_container(config))
        return


def _dotted(place: str, content: Any) -> Iterator[str]:
    if isinstance(content, Mapping):
        for key, value in content.items():
            inner = f"{place}.{key}" if place else str(key)
            yield inner
            yield from _dotted(inner, value)


def _given(key: str, arguments: Iterable[str]) -> str:
    return next((each for each in arguments if _key_of(each) == key), key)


def _key_of(argument: str) -> str:
    return argument.partition("=")[0].lstrip("+~")
