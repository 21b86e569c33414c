"""Checks of a composed configuration that need nothing heavy.

A mistake is told before torch, trajdata or Lightning are imported, which takes longer than to find
it. What only the parts themselves can judge, they judge when they are built.
"""

import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dmmv_conventions.cache import read_state
from dmmv_conventions.checks import (
    message,
    require,
    require_at_least,
    require_multiple,
    require_one_of,
    require_positive,
)
from dmmv_conventions.definitions import defined
from dmmv_conventions.modes import Mode
from dmmv_conventions.pretrained import PRETRAINED, checkpoint_path


def require_complete(content: Any) -> None:
    """Refuse a configuration in which a value still has to be given.

    Args:
        content: The configuration as plain containers, interpolations as they are written.

    Raises:
        ValueError: A value is `???`.
    """
    missing = sorted(key for key, value in _leaves("", content) if value == "???")
    if missing:
        given = " ".join(f"{key}=VALUE" for key in missing)
        raise ValueError(f"`{missing[0]}` must be given. Add {given}, or see --help.")


def _leaves(place: str, content: Any) -> Iterable[tuple[str, Any]]:
    if isinstance(content, Mapping):
        for key, value in content.items():
            yield from _leaves(f"{place}.{key}" if place else str(key), value)
    else:
        yield place, content


def require_same_type(key: str, default: Any, value: Any) -> None:
    """Refuse a value that cannot stand where its default does.

    Text may stand for a mapping (the name of a file in its place), a list for a number (one
    entry per wheel). Where there is no default, and for none, anything goes.

    Raises:
        ValueError: Text instead of a number, a truth value or a list; a number instead of a list of
            text or of a mapping; a fraction instead of a whole number.
    """
    if isinstance(default, Mapping) and isinstance(value, Mapping):
        for name in default.keys() & value.keys():
            require_same_type(f"{key}.{name}", default[name], value[name])
    elif value is not None:
        wanted = _refusal(default, value)
        remedy = f"Write ++{key}=VALUE to have it all the same."
        require(not wanted, key, f"be {wanted}", repr(value), "", remedy)


def _refusal(default: Any, value: Any) -> str:
    """What the value should be, "" if it may be what it is."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(default, bool):
        return "" if isinstance(value, bool | int) else "true or false"
    if isinstance(default, Mapping):
        return "" if isinstance(value, str | Mapping) else "settings, each with its name"
    if isinstance(default, int) and isinstance(value, float):
        return "" if value.is_integer() else "a whole number"
    if isinstance(default, int | float):
        return "" if number or isinstance(value, list) else "a number"
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
    require_file(argument, path, remedy)
    whole = path is not None and zipfile.is_zipfile(path)
    require(whole, argument, "be readable", "no archive", f"in {file}", remedy)


def require_modes(modes: Sequence[str]) -> None:
    """Refuse modes of transport that nobody knows.

    Raises:
        ValueError: A mode is unknown.
    """
    for name in modes:
        Mode.named(name)


def require_windows(modes: Sequence[str], dt_s: float, **durations_s: float) -> None:
    """Refuse modes of transport that nobody knows, and durations of no whole number of steps.

    Raises:
        ValueError: A mode is unknown, or a duration is no multiple of `dt_s`.
    """
    require_modes(modes)
    for name, duration_s in durations_s.items():
        require_multiple(name, duration_s, dt_s)


def require_data(windows: Mapping[str, Any], batch_size: int) -> None:
    """Refuse numbers of windows and batches that their parts would refuse once torch is there.

    Args:
        windows: Configuration of the windows, with `neighbors`, `radius_m` and `stride`.
        batch_size: Number of samples of a batch.

    Raises:
        ValueError: A number is out of its range.
    """
    require_at_least("data.neighbors", windows["neighbors"], 0)
    require_positive("data.radius_m", windows["radius_m"])
    require_at_least("data.stride", windows["stride"], 1)
    require_at_least("batch_size", batch_size, 1)


def told_of_data(module: Mapping[str, Any]) -> list[Any]:
    """Settings of a data module that judge themselves, without what reads the recordings.

    Windows whose modes are those of a training that is not read yet are left out.

    Args:
        module: Configuration of the module.
    """
    names = ["loading", "export", "augmentation", "balance"]
    known = module["windows"]["ego_modes"] is not None
    return [module[name] for name in [*(["windows"] if known else []), *names]]


def other_modes(modes: Sequence[str], vehicle: Mapping[str, Any]) -> list[str]:
    """Modes that another vehicle than this one drives; people on foot are not driven at all."""
    on_foot = (Mode.PEDESTRIAN.label, Mode.UNKNOWN.label)
    return [mode for mode in modes if mode.lower() not in (vehicle["mode"], *on_foot)]


def require_own_vehicle(modes: Sequence[str], vehicle: Mapping[str, Any], *, shared: bool) -> None:
    """Refuse agents that a vehicle of another mode would drive, unless it is meant so.

    Args:
        modes: Modes of transport of the ego.
        vehicle: Configuration of the vehicle, with its `name` and `mode`.
        shared: Whether the vehicle drives agents of all modes.

    Raises:
        ValueError: A mode is not that of the vehicle.
    """
    needs = f"be the mode of the vehicle '{vehicle['name']}' ({vehicle['mode']})"
    remedy = (
        "Train a run per mode (-m vehicle=bicycle,scooter 'modes=[${vehicle.mode}]'), or let one "
        "vehicle drive all of them (shared_vehicle=true)."
    )
    fits = shared or not other_modes(modes, vehicle)
    require(fits, "modes", needs, f"[{', '.join(modes)}]", "", remedy)


def require_situations(names: Sequence[str]) -> None:
    """Refuse situations that no window is told to belong to.

    They are read from the source: the class itself comes with torch.

    Raises:
        ValueError: A name is unknown.
    """
    found = defined("diffstack_mmv.data.Situations")
    known = [] if found is None else [name for name, _ in found.fields()]
    for name in names:
        require_one_of("situations", name, known)


def require_same_horizon(config: Mapping[str, Any], trained: Mapping[str, Any]) -> None:
    """Refuse other steps or another horizon than those that a checkpoint was trained with.

    Args:
        config: Configuration of the evaluation.
        trained: That of the training.

    Raises:
        ValueError: The step or the horizon differs.
    """
    for name in ("dt_s", "horizon_s"):
        wanted, found = trained[name], config[name]
        remedy = f"Give {name}={wanted}, or train with {name}={found}."
        requirement = f"be {wanted} as in the training"
        require(found == wanted, name, requirement, found, "for this checkpoint", remedy)


def other_history(config: Mapping[str, Any], trained: Mapping[str, Any]) -> str | None:
    """What to tell of windows with another past than those of the training, None without.

    A predictor takes any past, and a set of short tracks may be learned with less than is judged.
    """
    given, known = config["history_s"], trained["history_s"]
    if given == known:
        return None
    return (
        f"Windows have {given:g} s of the past, but the checkpoint was trained with {known:g} s. "
        f"Give history_s={known:g} for windows as in the training."
    )


def require_recordings(source: Mapping[str, Any]) -> None:
    """Refuse a source of recordings that is not there.

    Args:
        source: Configuration of a data source: with `root`, one that reads recordings itself, else
            the `name` of a data set in a `folder` that scripts/convert.py wrote.

    Raises:
        ValueError: The folder is missing, or holds no finished conversion.
    """
    if "root" in source:
        require_folder("root", source["root"], "Give data.root=FOLDER.")
    else:
        read_state(Path(source["folder"]), source["name"])


def require_split(argument: str, split: str, source: Mapping[str, Any]) -> None:
    """Refuse a split that a converted data set does not have; `all` stands for every one.

    Args:
        argument: Name of what gives the split.
        split: The split.
        source: Configuration of a data source, see `require_recordings`; one that reads recordings
            itself has splits of its own.

    Raises:
        ValueError: No scene belongs to it.
    """
    if "root" not in source and split != "all":
        scenes = read_state(Path(source["folder"]), source["name"])["scenes"]
        require_one_of(argument, split, sorted({scene["split"] for scene in scenes}))


def require_tracks(source: Mapping[str, Any], splits: Sequence[str], mode: str) -> None:
    """Refuse a converted data set without a track of a mode of transport.

    Args:
        source: Configuration of a data source, see `require_recordings`.
        splits: Splits to look at.
        mode: Mode of transport.

    Raises:
        ValueError: The folder is missing or no finished conversion, the mode is unknown, or nobody
            travels like that.
    """
    require_recordings(source)
    label = Mode.named(mode).label
    if "root" in source:
        return
    scenes = read_state(Path(source["folder"]), source["name"])["scenes"]
    # earlier caches do not say who is in a scene
    found = any(
        scene["split"] in splits and scene.get("agents", {label: 1}).get(label) for scene in scenes
    )
    remedy = "Choose another data set or another vehicle."
    where = f"in the splits {', '.join(splits)} of '{source['name']}'"
    require(found, "mode", "have tracks", f"none of mode '{mode}'", where, remedy)
