"""Processes that are killed, or meet each other in a folder."""

import os
import signal
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np
import torch

from benchmarks.faults.tables import THAB, text, thab_rows
from benchmarks.faults.trial import Result, Trial, each
from data_converters import ConversionSettings, ThabVruDataset, convert
from diffstack_mmv.simulation import (
    Campaign,
    CircleCrossing,
    ExactVerdict,
    HolonomicRobot,
    Method,
    OrcaCrowd,
    StraightLine,
    World,
)  # fmt: skip
from dmmv_conventions import cache as conventions
from dmmv_conventions.locks import alone_in


def in_a_child(work: Callable[[], object]) -> bool:
    """Do something in a process of its own; whether it was killed."""
    child = os.fork()
    if child == 0:
        # whatever happens, a child never goes on with the trials of its parent
        try:
            work()
        finally:
            os._exit(0)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def die(*_: object, **__: object) -> None:
    """Kill this process as a power cut would."""
    os.kill(os.getpid(), signal.SIGKILL)


def dying(module: object, name: str, call: int) -> None:
    """Let the nth call of a function kill the process."""
    original, count = getattr(module, name), iter(range(1, 10_000))
    setattr(module, name, lambda *a, **k: die() if next(count) == call else original(*a, **k))


def conversion(module: str, name: str, call: int, folder: Path) -> Result:
    """A conversion that is killed and begun again gives the same as one that never was."""
    place = folder / "cyclists" / "moving"
    place.mkdir(parents=True)
    for number in range(4):
        (place / f"{number}.csv").write_text(text(THAB, thab_rows(3.0 * number)))

    def settings(where: str) -> ConversionSettings:
        return ConversionSettings(ThabVruDataset(folder), folder / where, progress=False)

    def interrupted() -> None:
        dying(import_module(f"data_converters.{module}"), name, call)
        convert(settings("cache"))

    if not in_a_child(interrupted):
        return Result.SILENT
    resumed, whole = convert(settings("cache")), convert(settings("other"))
    same = resumed.as_dict()["scenes"] == whole.as_dict()["scenes"]
    files = [
        sorted(str(path.relative_to(folder / where)) for path in (folder / where).rglob("*"))
        for where in ("cache", "other")
    ]
    return Result.HELD if same and files[0] == files[1] else Result.LOST


def episodes(call: int, folder: Path) -> Result:
    """A benchmark that is killed goes on where it stopped."""
    module = import_module("diffstack_mmv.simulation.benchmark")
    world = World(HolonomicRobot(), OrcaCrowd(), ExactVerdict(3.0), 0.25)
    method = Method("straight", world, lambda: StraightLine(1.0), "a", "1")

    def all_of(where: str) -> list[np.ndarray]:
        chunks = Campaign(method, CircleCrossing(humans=2), range(4), folder / where, 2).run()
        return [chunk.record.motion.position.numpy() for chunk in chunks]

    def interrupted() -> None:
        dying(module, "write_chunk", call)
        all_of("a")

    if not in_a_child(interrupted):
        return Result.SILENT
    pairs = zip(all_of("a"), all_of("b"), strict=True)
    return Result.HELD if all(np.array_equal(*pair) for pair in pairs) else Result.LOST


def mixed(settings: str, code: str, folder: Path) -> Result:
    """Batches of other settings or code in the same folder."""
    world = World(HolonomicRobot(), OrcaCrowd(), ExactVerdict(3.0), 0.25)
    for told in (("a", "1"), (settings, code)):
        method = Method("straight", world, lambda: StraightLine(1.0), *told)
        list(Campaign(method, CircleCrossing(humans=2), range(2), folder, 2).run())
    return Result.SILENT


def shared_folder(folder: Path) -> Result:
    """Two runs in one folder."""
    with alone_in(folder, "out"), alone_in(folder, "out"):
        return Result.SILENT


def foreign_cache(folder: Path) -> Result:
    """A cache that another user has written."""
    before, user = conventions.ADMINISTRATOR, os.geteuid
    conventions.ADMINISTRATOR, os.geteuid = -1, lambda: -2  # type: ignore[assignment]
    try:
        conventions.require_own(folder, "Convert again")
    finally:
        conventions.ADMINISTRATOR, os.geteuid = before, user
    return Result.SILENT


def trials() -> Iterator[Trial]:
    """All interruptions."""
    torch.set_num_threads(1)
    points = [("scene_conversion", "write_scene", n) for n in (1, 3)]
    points += [("scene_conversion", "write_json", n) for n in range(1, 5)]
    points += [("conversion", "write_json", n) for n in range(1, 4)]
    kills = (
        (f"{name} of {at}, call {n}", partial(conversion, at, name, n)) for at, name, n in points
    )
    yield from each("kills while converting", kills)
    batches = ((f"batch {n}", partial(episodes, n)) for n in (1, 2))
    yield from each("kills while navigating", batches)
    others = {"other settings": ("b", "1"), "other code": ("a", "2")}
    yield from each("mixed runs", ((n, partial(mixed, *told)) for n, told in others.items()))
    yield from each("mixed runs", (("two in one folder", shared_folder),))
    yield from each("mixed runs", (("a cache of another user", foreign_cache),))
