"""Recordings in JSON files: IMPTC sequences and the VRU release, whole and broken."""

import json
import shutil
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, NamedTuple

from benchmarks.faults.trial import Result, Trial, Usual, converted, each, told_by
from data_converters import (
    ConversionSettings,
    ImptcDataset,
    ImptcVruDataset,
    convert,
    generate_sample,
    generate_vru_sample,
)

Change = Callable[[dict[str, Any]], str | None]
YEAR_S = 3.15e7


@cache
def sample(vru: bool) -> Path:
    """A small sample, made once."""
    folder = Path(mkdtemp())
    make = generate_vru_sample if vru else generate_sample
    make(folder, seed=3, sequences=(0, 50, 200), duration_s=16.0)
    return folder


def samples(content: dict[str, Any]) -> list[dict[str, Any]]:
    """The samples of a track."""
    return list(content["track_data"].values())


def first(**values: object) -> Change:
    """Change the first sample."""
    return lambda content: samples(content)[0].update(values)


def every(**values: object) -> Change:
    """Change all samples."""
    return lambda content: [each.update(values) for each in samples(content)] and None


def later(seconds: float, share: float) -> Change:
    """Move a share of the samples in time."""

    def change(content: dict[str, Any]) -> None:
        all_of_them = samples(content)
        for sample in all_of_them[: max(int(share * len(all_of_them)), 1)]:
            unit = 1e6 if int(sample["ts"]) > 1e14 else 1e3
            sample["ts"] = int(sample["ts"]) + int(seconds * unit)

    return change


def scaled(factor: float, only_middle: bool = False) -> Change:
    """Scale coordinates."""

    def change(content: dict[str, Any]) -> None:
        whole = samples(content)
        for sample in whole[len(whole) // 2 :][: 1 if only_middle else None]:
            sample["coordinates"] = [factor * (5.0 + value) for value in sample["coordinates"]]

    return change


def without(name: str) -> Change:
    """Leave out a key of all samples."""
    return lambda content: [each.pop(name, None) for each in samples(content)] and None


def cut(content: dict[str, Any]) -> str:
    """Half a file."""
    whole = json.dumps(content)
    return whole[: len(whole) // 2]


def replaced(**values: object) -> Change:
    """Replace sections."""
    return lambda content: content.update(values)


CHANGES: dict[str, Change] = {
    "cut off": cut,
    "empty": lambda content: "",
    "a list": lambda content: "[]",
    "a number": lambda content: "7",
    "null": lambda content: "null",
    "nested 100,000 deep": lambda content: "[" * 100_000,
    "nested objects 100,000 deep": lambda content: '{"a":' * 100_000,
    "a number of 5,000 digits": lambda content: '{"track_data": ' + "9" * 5000 + "}",
    "a web page": lambda content: "<html></html>",
    "no samples": replaced(track_data={}),
    "samples as a list": replaced(track_data=[1, 2]),
    "samples that are numbers": replaced(track_data={"a": 1}),
    "no overview": replaced(overview=None),
    "no class": replaced(overview={"class_name": "x"}),
    "unknown class": replaced(overview={"class_id": 99}),
    "class as a list": replaced(overview={"class_id": [1]}),
    "infinite class": replaced(overview={"class_id": float("inf")}),
    "no time": without("ts"),
    "time in words": every(ts="noon"),
    "time as a list": every(ts=[1]),
    "time in s": every(ts=1_600_000_000),
    "time in ns": every(ts=1_600_000_000_000_000_000),
    "negative time": every(ts=-5),
    "NaN as a time": first(ts=float("nan")),
    "a time of 5,000 digits": first(ts="9" * 5000),
    "all times equal": every(ts=1_600_000_000_000_000),
    "half a year later": later(YEAR_S, 0.5),
    "one sample ten years early": later(-10 * YEAR_S, 0.0),
    "one sample a day late": later(86400.0, 0.0),
    "no coordinates": without("coordinates"),
    "coordinates as text": first(coordinates="here"),
    "two coordinates": first(coordinates=[1.0, 2.0]),
    "NaN coordinates": first(coordinates=[float("nan"), 0.0, 0.0]),
    "infinite coordinates": first(coordinates=[float("inf"), 0.0, 0.0]),
    "coordinates of 1e308": first(coordinates=[1e308, -1e308, 0.0]),
    "a coordinate of 400 digits": first(coordinates=[10**400, 0.0, 0.0]),
    "coordinates of 1e9 m": every(coordinates=[1e9, 1e9, 0.0]),
    "millimetres": scaled(1e3),
    "a jump of 1 km": scaled(0.0, True) and first(coordinates=[900.0, 900.0, 0.0]),
    "broken cuboids": every(cuboid=[1, 2, 3]),
    "ragged cuboids": every(cuboid=[[[0, 0, 0]], 1]),
    "cuboids of 1e308": every(cuboid=[[[1e308] * 3, [-1e308] * 3]] * 12),
    "cuboids of no size": every(cuboid=[[[1.0] * 3, [1.0] * 3]] * 12),
    "no status that counts": every(status=0),
}  # fmt: skip


def tried(vru: bool, change: Change, folder: Path) -> Result:
    """Convert a sample of which one track is broken."""
    raw = folder / "raw"
    shutil.copytree(sample(vru), raw)
    # the longest one, so that it would have been kept
    path = max(raw.rglob("track.json"), key=lambda path: (path.stat().st_size, str(path)))
    content = json.loads(path.read_text())
    changed = change(content)
    path.write_text(changed if isinstance(changed, str) else json.dumps(content))
    dataset = (ImptcVruDataset if vru else ImptcDataset)(raw)
    return converted(dataset, folder, expected(vru).agents - 1, expected(vru).told)


class Whole(NamedTuple):
    """What a conversion of the whole sample gives."""

    agents: int
    told: Usual


@cache
def expected(vru: bool) -> Whole:
    """Agents of the whole sample, a track with a gap counted once, and what is told of it."""
    dataset = (ImptcVruDataset if vru else ImptcDataset)(sample(vru))
    report = convert(ConversionSettings(dataset, Path(mkdtemp()), progress=False))
    told = told_by(report)
    return Whole(report.totals()["tracks_read"] - told.rejected, told)


def trials() -> Iterator[Trial]:
    """All faults of these files."""
    for kind, vru in (("IMPTC sequences", False), ("IMPTC VRU release", True)):
        yield from each(kind, ((n, partial(tried, vru, c)) for n, c in CHANGES.items()))
