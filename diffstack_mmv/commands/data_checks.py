"""Checks of what a configuration says of recordings and their windows; nothing heavy is needed.

As in `config_checks`, a mistake is told before what takes seconds is imported.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from diffstack_mmv.commands.config_checks import require_folder
from dmmv_conventions.cache import SPLITS, conversion_command, read_state
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


def require_modes(modes: Sequence[str]) -> None:
    """Refuse modes of transport that nobody knows.

    Raises:
        ValueError: A mode is unknown, or there is a single name in place of a list.
    """
    remedy = f"Write modes=[{modes}]."
    require(not isinstance(modes, str), "modes", "be a list", repr(modes), "", remedy)
    for name in modes:
        Mode.named(name, "modes")


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
    known = [] if found is None else [field.name for field in found.fields()]
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


def new_modes(modes: Sequence[str], trained: Mapping[str, Any]) -> str | None:
    """What to tell of egos of modes that the training had none of, None without.

    Args:
        modes: Modes of transport of the ego, as they are judged.
        trained: Configuration of the training.

    Returns:
        The sentence; what has learned nothing (`epochs=0`) knows no mode better than another.
    """
    known = {mode.lower() for mode in trained["modes"]}
    others = sorted({mode.lower() for mode in modes} - known)
    if not others or trained["epochs"] == 0:
        return None
    return (
        f"Egos of mode {', '.join(others)} are judged, but the checkpoint was trained with those "
        f"of {', '.join(sorted(known))} alone."
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


class Conversion(NamedTuple):
    """A converted data set that is read."""

    name: str
    cache: Path


def require_conversions(wanted: Iterable[Conversion]) -> None:
    """Refuse to begin before all data sets are converted, and tell how each is.

    Raises:
        ValueError: A cache is missing, unfinished or of another version.
    """
    lacking = [each for each in dict.fromkeys(wanted) if not _is_finished(each)]
    if lacking:
        found = ", ".join(f"none of '{each.name}' in {each.cache}" for each in lacking)
        remedy = f"Run {'; '.join(conversion_command(*each) for each in lacking)}"
        needs = "hold the finished conversion of every data set"
        raise ValueError(message("data.cache", needs, found, "", remedy))


def _is_finished(conversion: Conversion) -> bool:
    try:
        read_state(conversion.cache, conversion.name)
    except ValueError:
        return False
    return True


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
        require_one_of(argument, split, _splits_of(_scenes(source)))


def require_tracks(source: Mapping[str, Any], splits: Sequence[str], mode: str) -> None:
    """Refuse a converted data set without a track of a mode of transport.

    Args:
        source: Configuration of a data source, see `require_recordings`.
        splits: Splits to look at.
        mode: Mode of transport.

    Raises:
        ValueError: The folder is missing or no finished conversion, the mode or a split is
            unknown, or nobody travels like that.
    """
    require_recordings(source)
    label = Mode.named(mode).label
    if "root" in source:
        return
    scenes = _scenes(source)
    _require_splits(splits, _splits_of(scenes))
    # earlier caches do not say who is in a scene
    found = any(
        scene["split"] in splits and scene.get("agents", {label: 1}).get(label) for scene in scenes
    )
    remedy = "Choose another data set or another vehicle."
    where = f"in the splits {', '.join(splits)} of '{source['name']}'"
    require(found, "mode", "have tracks", f"none of mode '{mode}'", where, remedy)


def require_step_of(source: Mapping[str, Any], dt_s: float) -> None:
    """Refuse another step than that of the tracks, which are read row by row.

    Args:
        source: Configuration of a data source, see `require_recordings`.
        dt_s: Step of the configuration in s.

    Raises:
        ValueError: The folder is no finished conversion, or its step differs.
    """
    if "root" in source:
        return
    found = read_state(Path(source["folder"]), source["name"])["dt_s"]
    remedy = f"Give dt_s={found:g}, or convert the data with dt_s={dt_s:g}."
    same, where = math.isclose(found, dt_s, rel_tol=1e-6), f"for '{source['name']}'"
    require(same, "dt_s", f"be {found:g} as in the conversion", dt_s, where, remedy)


def _scenes(source: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What a finished conversion tells of its scenes."""
    return read_state(Path(source["folder"]), source["name"])["scenes"]


def _splits_of(scenes: Sequence[Mapping[str, Any]]) -> list[str]:
    """Splits that scenes belong to, sorted."""
    return sorted({scene["split"] for scene in scenes})


def _require_splits(splits: Sequence[str], known: Sequence[str]) -> None:
    """Refuse splits of no scene, but a usual one beside another that has some."""
    require(len(splits) > 0, "splits", f"name some of {', '.join(known)}", "[]")
    some = not set(splits).isdisjoint(known)
    for split in splits:
        if not (some and split in SPLITS):
            require_one_of("splits", split, known)
