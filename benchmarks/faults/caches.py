"""Converted caches and exports with files that are lost, cut off or changed."""

import shutil
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import mkdtemp

import pandas as pd

from benchmarks.faults.tables import Content, put
from benchmarks.faults.trial import Result, Trial, each
from data_converters import AutobikeDataset, ConversionSettings, convert
from diffstack_mmv.data import (
    ConvertedCache,
    ExportedWindows,
    ExportSettings,
    WindowSettings,
    read_rides,
)
from diffstack_mmv.data.export import Export, export_windows
from diffstack_mmv.identification.measured import (
    RideWindowSettings,
    cut_windows,
    measured_rides,
)
from tests.data_converters.synthetic import autobike_log

NAME, PLACE = "autobike", (("train", "val", "test"), "bicycle")
WINDOWS = WindowSettings(ego_modes=("bicycle",), history_s=1.0, horizon_s=1.0)
LOST: dict[str, Content | None] = {
    "lost": None,
    "empty": "",
    "text": "no table",
    "zero bytes": "\0" * 4000,
    "a folder": Path.mkdir,
}
Change = Callable[[pd.DataFrame], pd.DataFrame]
CHANGES: dict[str, Change] = {
    "without agents": lambda t: t.drop(columns="agent_id"),
    "without a clock": lambda t: t.drop(columns="time_s"),
    "without its values": lambda t: t[["agent_id", "time_s"]],
    "with text in its values": lambda t: t.assign(**{c: "x" for c in t.columns[2:]}),
    "with NaN in all values": lambda t: t.assign(**{c: float("nan") for c in t.columns[2:]}),
    "with infinite values": lambda t: t.assign(**{c: float("inf") for c in t.columns[2:]}),
    "with times of NaN": lambda t: t.assign(time_s=float("nan")),
    "without rows": lambda t: t[:0],
    "of somebody else": lambda t: t.assign(agent_id="nobody"),
    "of another hour": lambda t: t.assign(time_s=t["time_s"] + 3600.0),
}


@cache
def converted() -> Path:
    """A cache of one log, with an export of its windows."""
    folder = Path(mkdtemp())
    path = folder / "raw" / "09_06" / "0.csv"
    path.parent.mkdir(parents=True)
    autobike_log().to_csv(path, index=False, float_format="%.12g")
    settings = ConversionSettings(AutobikeDataset(folder / "raw"), folder / "c", progress=False)
    convert(settings)
    exported(folder / "c")
    return folder / "c"


def exported(folder: Path) -> Path:
    """Make or find the windows of a cache."""
    source = ConvertedCache(NAME, str(folder))
    (split,) = {scene["split"] for scene in source.scenes()}
    settings = ExportSettings(str(folder / "exports"), workers=0, progress=False)
    return export_windows(Export(source, split, WINDOWS), settings)


def copied(folder: Path) -> Path:
    """A copy of the cache."""
    return Path(shutil.copytree(converted(), folder / "c"))


def damage(path: Path, content: Content | None) -> None:
    """Put something else in the place of a file."""
    path.unlink()
    if content is not None:
        put(path, content)


def cut_rides(folder: Path) -> Result:
    """Read what `identify controls=measured` reads."""
    source = ConvertedCache(NAME, str(folder))
    cut_windows(measured_rides(*read_rides(source, *PLACE)), RideWindowSettings())
    return Result.SILENT


def ride(pattern: str, content: Content | None, folder: Path) -> Result:
    """Read rides of a cache with a file that is none."""
    place = copied(folder)
    damage(next((place / NAME).glob(f"*/{pattern}")), content)
    return cut_rides(place)


def changed(table: str, change: Change, folder: Path) -> Result:
    """Read rides of a cache with a table beside the scene that says something else."""
    place = copied(folder)
    path = next((place / NAME).glob(f"*/{table}.parquet"))
    change(pd.read_parquet(path)).to_parquet(path, index=False)
    return cut_rides(place)


def windows(pattern: str, content: Content | None, folder: Path) -> Result:
    """Read windows of a cache with a file that is none."""
    place = copied(folder)
    shutil.rmtree(place / "exports")
    damage(next((place / NAME).glob(f"*/{pattern}")), content)
    exported(place)
    return Result.SILENT


def export(name: str, content: Content | None, folder: Path) -> Result:
    """Open an export with a file that is none."""
    place = exported(copied(folder))
    damage(place / name, content)
    ExportedWindows(place).digest()
    return Result.SILENT


def trials() -> Iterator[Trial]:
    """All faults of caches."""
    scene = next((converted() / NAME).glob("*/controls.parquet")).parent
    files = {"metadata": "scene_metadata*.dill", "rows": "agent_data*.feather"}
    tables = {name: f"{name}.parquet" for name in ("controls", "sensors", "lean")}
    for name, pattern in (files | tables).items():
        whole = next(scene.glob(pattern)).read_bytes()
        faults = LOST | {"cut off": whole[: len(whole) // 2], "cut at its end": whole[:-5]}
        # a ride need not have a gyroscope or a measured lean
        needed = {n: c for n, c in faults.items() if n != "lost" or name != "lean"}
        named = ((f"{name}: {n}", partial(ride, pattern, c)) for n, c in needed.items())
        yield from each("rides of a cache", named)
        if name in files:
            named = ((f"{name}: {n}", partial(windows, pattern, c)) for n, c in faults.items())
            yield from each("windows of a cache", named)
    for table in ("controls", "sensors"):
        named = ((f"{table} {n}", partial(changed, table, c)) for n, c in CHANGES.items())
        yield from each("rides of a cache", named)
    place = exported(converted())
    for name in sorted({path.name for path in place.iterdir()} - {"situations.npy"}):
        whole = (place / name).read_bytes()
        faults = LOST | {"cut off": whole[: len(whole) // 2]}
        named = ((f"{name}: {n}", partial(export, name, c)) for n, c in faults.items())
        yield from each("exports of a cache", named)
