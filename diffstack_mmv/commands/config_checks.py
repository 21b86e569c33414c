"""Checks of a composed configuration that need nothing heavy.

A mistake is told before torch, trajdata or Lightning are imported, which takes longer than to find
it. What only the parts themselves can judge, they judge when they are built.
"""

import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from dmmv_conventions.checks import message, require
from dmmv_conventions.pretrained import PRETRAINED, checkpoint_path


def require_complete(content: Any) -> None:
    """Refuse a configuration in which a value still has to be given.

    Args:
        content: The configuration as plain containers, interpolations as they are written.

    Raises:
        ValueError: A value is `???`.
    """
    missing = sorted(key for key, value in leaves("", content) if value == "???")
    if missing:
        given = " ".join(f"{key}=VALUE" for key in missing)
        raise ValueError(f"`{missing[0]}` must be given. Add {given}, or see --help.")


def leaves(place: str, content: Any) -> Iterable[tuple[str, Any]]:
    """Keys of all values of a configuration, each with its value; a list is one.

    Args:
        place: Where the content stands, "" for all of it.
        content: Plain containers.
    """
    if isinstance(content, Mapping):
        for key, value in content.items():
            yield from leaves(f"{place}.{key}" if place else str(key), value)
    else:
        yield place, content


def require_same_type(key: str, default: Any, value: Any, in_part: bool = False) -> None:
    """Refuse a value that cannot stand where its default does.

    A string is accepted in place of a mapping (the name of a file), and within a part a list in
    place of a number (one entry per wheel, numbers of devices), which a setting of the command
    itself never is. Where there is no default, and for none, anything goes.

    Args:
        key: Where it stands, names and dots.
        default: What stands there by default.
        value: What is to stand there.
        in_part: Whether it belongs to something that is built, which judges it as well.

    Raises:
        ValueError: Text instead of a number, a truth value or a list; a list instead of a number of
            the command; a number instead of a list of text or of a mapping; a fraction instead of a
            whole number.
    """
    if isinstance(default, Mapping) and isinstance(value, Mapping):
        inside = in_part or "_target_" in default
        for name in default.keys() & value.keys():
            require_same_type(f"{key}.{name}", default[name], value[name], inside)
    elif value is not None:
        wanted = _refusal(default, value, in_part)
        remedy = f"Write ++{key}=VALUE to have it all the same."
        if wanted == "a list":
            remedy = f"Write {key}=[{value}]."
        elif wanted in ("a number", "true or false") and isinstance(value, list):
            remedy = f"Give one; -m {key}=A,B runs the command for each of several."
        require(not wanted, key, f"be {wanted}", repr(value), "", remedy)


def _refusal(default: Any, value: Any, in_part: bool) -> str:
    """What the value should be, "" if it may be what it is."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(default, bool):
        return "" if isinstance(value, bool | int) else "true or false"
    if isinstance(default, Mapping):
        return "" if isinstance(value, str | Mapping) else "settings, each with its name"
    if isinstance(default, int) and isinstance(value, float):
        return "" if value.is_integer() else "a whole number"
    if isinstance(default, int | float):
        return "" if number or (in_part and isinstance(value, list)) else "a number"
    if isinstance(default, list):
        of_numbers = bool(default) and isinstance(default[0], int | float)
        return "" if isinstance(value, list) or (number and of_numbers) else "a list"
    return ""


SEED_MAX = 2**32 - 1
"""Largest seed that every generator takes."""


def require_seed(seed: int | None) -> None:
    """Refuse a seed that not all random number generators take; none is that of a command without.

    Raises:
        ValueError: It is negative or too large.
    """
    fits = seed is None or 0 <= seed <= SEED_MAX
    require(fits, "seed", f"lie in [0, {SEED_MAX}]", seed)


def require_share(argument: str, share: float) -> None:
    """Refuse what is neither a share nor a number of batches.

    Raises:
        ValueError: It is no fraction above 0 up to 1, and no whole number above it.
    """
    fits = 0.0 < share <= 1.0 or (share > 1.0 and float(share).is_integer())
    require(fits, argument, "lie in (0, 1], or be a whole number of batches", share)


def require_folder(argument: str, folder: str | None, remedy: str) -> None:
    """Refuse a folder that is not given or not there.

    Raises:
        ValueError: There is no such folder.
    """
    found = folder is not None and Path(folder).expanduser().is_dir()
    require(found, argument, "be an existing folder", repr(folder), "", remedy)


def require_file(argument: str, file: str | None, remedy: str) -> None:
    """Refuse a file that is not given or not there.

    Raises:
        ValueError: There is no such file.
    """
    if file is None:
        raise ValueError(message(argument, "be given", file, "", remedy))
    require(Path(file).is_file(), argument, "be an existing file", repr(file), "", remedy)


def require_checkpoint(argument: str, file: str | None) -> None:
    """Refuse a checkpoint that is not given, not there, or no archive as torch writes it.

    Raises:
        ValueError: There is no such checkpoint.
    """
    remedy = f"Give the path of a checkpoint that scripts/train.py wrote, or {PRETRAINED}."
    path = None if file is None else str(checkpoint_path(file))
    if path is not None and (inside := Path(path) / "checkpoints/best.ckpt").is_file():
        remedy = f"Did you mean {inside}?"  # of the run in that folder
    require_file(argument, path, remedy)
    whole = path is not None and zipfile.is_zipfile(path)
    require(whole, argument, "be readable", "no archive", f"in {file}", remedy)
