"""Reading of IMPTC track files: order, units, classes, and every fault a file can have."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from data_converters.errors import (
    ConversionError,
    RejectReason,
    TrackError,
    fault,
    refuse_track,
    require,
)
from data_converters.imptc.cuboid import measure_cuboids
from data_converters.imptc.modes import CLASS_MODES
from data_converters.limits import USUAL, RecordingLimits
from data_converters.plain_files import require_plain
from dmmv_conventions.checks import require_switch
from dmmv_conventions.modes import Mode

if TYPE_CHECKING:
    from trajdata.data_structures.agent import FixedExtent

Array = NDArray[np.float64]

UTM32_OFFSET_M = (511570.38, 5535358.32, 150.22)
"""Origin of the local frame in UTM zone 32 N."""

KMH = 1.0 / 3.6


@dataclass(frozen=True)
class TrackFilter:
    """Which samples and tracks to keep.

    Attributes:
        min_status: Smallest status of a sample: 1 candidate, 2 accepted.
        min_class_prob: Smallest median class probability of a track, 0-1.
        utm: Whether positions are given in UTM 32 N instead of the local frame.
    """

    min_status: int = 1
    min_class_prob: float = 0.0
    utm: bool = False

    def __post_init__(self) -> None:
        require_switch("utm", self.utm)


class TrackFile(NamedTuple):
    """Content of one track file, ordered by time.

    timestamp (n,) µs UTC; position (n, 3) m; speed (n,) m/s as stated, NaN where absent; axis (n,)
    rad modulo pi and extent m where every sample has a cuboid; dropped: samples left out.
    """

    mode: Mode
    timestamp: NDArray[np.int64]
    position: Array
    speed: Array
    axis: Array | None
    extent: FixedExtent | None
    dropped: int


def load_json(path: Path) -> Any:
    """Content of a JSON file.

    Raises:
        TrackError: If the file is absent, no plain file, too large, cut off, nested too deep or no
            JSON.
    """
    try:
        require_plain(path)
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except TrackError:
        raise
    except OSError as error:
        remedy = "Unpack the archive again."
        refuse_track(RejectReason.UNREADABLE, "file", "be a file", error, path, remedy)
    except (ValueError, RecursionError) as error:
        remedy = "The file is damaged or half unpacked: unpack the archive again."
        refuse_track(RejectReason.BROKEN_JSON, "file", "be JSON", error, path, remedy)


def microseconds(value: object, where: str) -> int:
    """A timestamp of a file in integer microseconds UTC.

    Numbers and digits in text are taken; a magnitude of 1e12 is milliseconds, 1e15 microseconds.

    Raises:
        TrackError: If it is no number, or of another magnitude.
    """
    try:
        number = int(str(value))
    except ValueError:
        needs, remedy = "be a whole number", "Unpack the archive again."
        refuse_track(RejectReason.NO_TIMESTAMPS, "ts", needs, value, where, remedy)
    if not 10**11 <= number < 10**17:
        needs = "be microseconds since 1970 (about 1.7e15)"
        remedy = "Milliseconds are converted; other units cannot be told apart."
        refuse_track(RejectReason.TIMESTAMP_UNIT, "ts", needs, number, where, remedy)
    return number if number >= 10**14 else number * 1000


def parse_track(
    content: Any, where: str, keep: TrackFilter, limits: RecordingLimits = USUAL
) -> TrackFile:
    """Samples of one track, ordered by their inner timestamp.

    Args:
        content: Content of a track.json.
        where: The file, for messages.
        keep: What to keep.
        limits: Times and places that are possible.

    Returns:
        The track.

    Raises:
        TrackError: If class, timestamps, coordinates or cuboids are missing, wrong or impossible,
            or the filter leaves nothing.
    """
    samples = _section(content, "track_data", where, RejectReason.NO_TIMESTAMPS)
    mode = _mode(_section(content, "overview", where, RejectReason.MISSING_FIELD), where)
    kept = [sample for sample in samples.values() if _status(sample, keep)]
    if not kept:
        refuse_track(
            RejectReason.LOW_STATUS,
            "status",
            f"reach {keep.min_status}",
            "no such sample",
            where,
            "Lower it.",
        )
    _check_probability(kept, keep, where)
    stamps = np.array([_timestamp(sample, where) for sample in kept], dtype=np.int64)
    stamps, order = np.unique(stamps, return_index=True)
    ordered = [kept[i] for i in order.tolist()]
    position = _positions(ordered, where)
    limits.check_samples((stamps - stamps[0]) / 1e6, position, where)
    axis, extent = _body(ordered, where)
    return TrackFile(
        mode=mode,
        timestamp=stamps,
        position=position + (np.array(UTM32_OFFSET_M) if keep.utm else 0.0),
        speed=np.array([_number(sample.get("velocity")) for sample in ordered]) * KMH,
        axis=axis,
        extent=extent,
        dropped=len(samples) - len(stamps),
    )


def _section(content: Any, name: str, where: str, reason: RejectReason) -> Mapping[str, Any]:
    section = content.get(name) if isinstance(content, dict) else None
    if not isinstance(section, dict) or not section:
        refuse_track(reason, name, "be a filled object", section, where, "Unpack it again.")
    return section


def _mode(overview: Mapping[str, Any], where: str) -> Mode:
    known = sorted(CLASS_MODES)
    try:
        return CLASS_MODES[int(overview["class_id"])]
    except (KeyError, TypeError, ValueError, OverflowError):
        found = overview.get("class_id")
        remedy = "Add it to data_converters/imptc/modes.py if the data set has a new class."
        refuse_track(
            RejectReason.UNKNOWN_CLASS, "class_id", f"be one of {known}", found, where, remedy
        )


def time_span_us(content: Any, where: str) -> tuple[int, int]:
    """First and last time of a track in microseconds UTC.

    Raises:
        TrackError: If there are no samples, or one has no usable time.
    """
    samples = _section(content, "track_data", where, RejectReason.NO_TIMESTAMPS)
    stamps = [_timestamp(sample, where) for sample in samples.values() if isinstance(sample, dict)]
    if not stamps:
        needs, remedy = "hold samples", "Unpack the archive again."
        refuse_track(RejectReason.NO_TIMESTAMPS, "track_data", needs, "none", where, remedy)
    return min(stamps), max(stamps)


def _status(sample: Any, keep: TrackFilter) -> bool:
    if not isinstance(sample, dict):
        return False
    return _number(sample.get("status", keep.min_status)) >= keep.min_status


def _check_probability(samples: list[dict[str, Any]], keep: TrackFilter, where: str) -> None:
    stated = [_number(sample.get("class_prob", 1.0)) for sample in samples]
    median = float(np.nanmedian(stated)) if np.isfinite(stated).any() else 1.0
    if median < keep.min_class_prob:
        refuse_track(
            RejectReason.LOW_PROBABILITY,
            "class_prob",
            f"reach {keep.min_class_prob}",
            median,
            where,
            "Lower it.",
        )


def _timestamp(sample: Mapping[str, Any], where: str) -> int:
    if sample.get("ts") is None:
        refuse_track(
            RejectReason.NO_TIMESTAMPS,
            "ts",
            "stand in every sample",
            "none",
            where,
            "Unpack the archive again.",
        )
    return microseconds(sample["ts"], where)


def _number(value: object) -> float:
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return float("nan")


def _positions(samples: list[dict[str, Any]], where: str) -> Array:
    position = np.array([_point(sample.get("coordinates")) for sample in samples])
    bad = ~np.isfinite(position).all(axis=1)
    if bad.any():
        sample = samples[int(np.argmax(bad))]
        place = f"{where}, ts {sample['ts']}"
        found = sample.get("coordinates")
        refuse_track(
            RejectReason.NOT_FINITE,
            "coordinates",
            "be three finite numbers",
            found,
            place,
            "Remove the track.",
        )
    return position


def _point(value: object) -> list[float]:
    if not isinstance(value, list) or len(value) != 3:
        return [float("nan")] * 3
    return [_number(part) for part in value]


def _body(samples: list[dict[str, Any]], where: str) -> tuple[Array | None, FixedExtent | None]:
    """Axis per sample and median size, from the cuboids; None unless every sample has one."""
    if not all("cuboid" in sample for sample in samples):
        return None, None
    boxes = measure_cuboids([sample["cuboid"] for sample in samples], where)
    size = [float(np.median(side)) for side in (boxes.length, boxes.width, boxes.height)]
    from trajdata.data_structures.agent import FixedExtent

    return boxes.axis, FixedExtent(*size)


def refuse_missing(what: str, found: str, root: Path) -> NoReturn:
    """Refuse a `root` that does not hold a data set; `what` tells what is expected.

    Raises:
        ConversionError: Always.
    """
    remedy = (
        "Run scripts/download_imptc.py (it resumes), or scripts/generate_sample.py for a sample."
    )
    archives = [path.name for path in root.glob("*.tar.gz")]
    if not root.is_dir():
        found = "no such folder"
    elif archives:
        found = f"archives that are not unpacked {archives}"
    raise ConversionError(f"{fault('root', f'hold {what}', found, root, remedy)}")


def refuse_unfinished(root: Path) -> None:
    """Refuse a folder in which a download is under way or was interrupted.

    Raises:
        ConversionError: If it holds an unfinished download or a half unpacked archive.
    """
    leftovers = sorted(path.name for mark in ("*.part", ".unpacking_*") for path in root.glob(mark))
    remedy = "Run scripts/download_imptc.py again (it resumes), or remove them."
    require(not leftovers, "root", "be a finished download", leftovers, root, remedy)
