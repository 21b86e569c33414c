"""Generation of sample sequences and of a sample of the VRU release cut from them."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from data_converters.errors import require
from data_converters.imptc.modes import VEHICLE_CLASSES
from data_converters.imptc.sample.cast import make_cast
from data_converters.imptc.sample.files import Spelling, track_content, write_context, write_json
from data_converters.imptc.sample.lights import SignalPlan
from data_converters.imptc.sample.sensor import detect, master_clock
from data_converters.imptc.sample.traffic import STEP_S, simulate

SAMPLE_SEQUENCES = (0, 1, 2, 100, 50, 150, 200, 203)
"""Numbers that fall into set_01, set_03 (train), set_02, set_04 (val) and set_05 (test)."""

FIRST_START = datetime(2023, 3, 22, 8, 15, 6, tzinfo=UTC)
RELEASE_SPLITS = ("train", "train", "eval", "test")


class _Sequence(NamedTuple):
    """One simulated sequence: folder name, and (track id, class, content) of each track."""

    name: str
    tracks: list[tuple[int, int, dict[str, Any]]]
    clock_us: np.ndarray
    plan: SignalPlan
    spelling: Spelling
    rng: np.random.Generator


def generate_sample(
    out: Path, seed: int = 0, sequences: Sequence[int] = SAMPLE_SEQUENCES, duration_s: float = 30.0
) -> list[Path]:
    """Write sample sequences in the IMPTC folder layout; equal arguments give equal bytes.

    The folder of a sequence appears when it is complete.

    Args:
        out: Folder that gets one folder per sequence.
        seed: Seed of everything.
        sequences: Sequence numbers, which decide set and split.
        duration_s: Length of a sequence in s, at least 16.

    Returns:
        The folders written.

    Raises:
        ConversionError: If the duration is too short, a number is not in 0..9999 or given twice, or
            a folder exists.
    """
    folders = []
    for sequence in _simulated(seed, sequences, duration_s):
        folder = out / sequence.name
        remedy = "Choose another folder or remove it."
        require(not folder.exists(), "out", "not hold the sequence yet", folder.name, out, remedy)
        partial = out / f".partial_{sequence.name}"
        shutil.rmtree(partial, ignore_errors=True)  # of one that was killed
        try:
            _write(sequence, partial)
            os.replace(partial, folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
        folders.append(folder)
    return folders


def generate_vru_sample(
    out: Path, seed: int = 0, sequences: Sequence[int] = SAMPLE_SEQUENCES, duration_s: float = 30.0
) -> list[Path]:
    """Write a sample of the VRU-trajectory release, cut from the sequences of `generate_sample`.

    The VRUs of each class are dealt to train, train, eval, test in turn, whatever the set of their
    sequence, as the real release mixes sequences; `src_info.txt` says where they come from.

    Args:
        out: Folder that gets train, eval and test.
        seed: As in `generate_sample`.
        sequences: Sequence numbers.
        duration_s: Length of a sequence in s, at least 16.

    Returns:
        The three folders.

    Raises:
        ConversionError: If the duration is too short, a number is not in 0..9999, or `out` holds
            tracks.
    """
    present = [split for split in RELEASE_SPLITS if (out / split).exists()]
    remedy = "Choose another folder or remove them."
    require(not present, "out", "not hold train, eval or test yet", present, out, remedy)
    dealt: dict[int, int] = {}
    combined: dict[str, dict[str, Any]] = {split: {} for split in dict.fromkeys(RELEASE_SPLITS)}
    for sequence in _simulated(seed, sequences, duration_s):
        for track, class_id, content in sequence.tracks:
            if class_id in VEHICLE_CLASSES:
                continue
            split = RELEASE_SPLITS[dealt.get(class_id, 0) % len(RELEASE_SPLITS)]
            dealt[class_id] = dealt.get(class_id, 0) + 1
            name = f"{len(combined[split]):04d}"
            combined[split][name] = content
            write_json(out / split / name / "track.json", content)
            source = f"{sequence.name.partition('_')[2]}/{track:03d}"
            (out / split / name / "src_info.txt").write_text(source + "\n", encoding="utf-8")
    for split, tracks in combined.items():
        write_json(out / f"{split}_tracks.json", tracks)
    return [out / split for split in combined]


def _write(sequence: _Sequence, folder: Path) -> None:
    for track, class_id, content in sequence.tracks:
        family = "vehicles" if class_id in VEHICLE_CLASSES else "vrus"
        write_json(folder / family / f"{track:03d}" / "track.json", content)
    write_context(
        folder / "context", sequence.clock_us, sequence.plan, sequence.spelling, sequence.rng
    )


def _simulated(seed: int, sequences: Sequence[int], duration_s: float) -> Iterator[_Sequence]:
    remedy = "Shorter ones hold no window of 4 s + 3 s for late starters."
    require(duration_s >= 16.0, "duration_s", "be at least 16", duration_s, "", remedy)
    for number in sequences:
        fits = 0 <= number <= 9999
        require(fits, "sequences", "lie in 0..9999", number, "", "Sets are 0 to 269.")
    once = len(set(sequences)) == len(sequences)
    require(once, "sequences", "name each sequence once", list(sequences))
    for number in sequences:
        yield _simulate(seed, number, duration_s)


def _simulate(seed: int, number: int, duration_s: float) -> _Sequence:
    rng = np.random.default_rng([seed, number])
    plan = SignalPlan(offset_s=float(rng.uniform(0.0, 28.0)))
    cast = make_cast(number, duration_s, rng)
    motions = simulate(cast, plan, duration_s)
    start = FIRST_START + timedelta(minutes=5 * number)
    clock_us = master_clock(round(duration_s / STEP_S), round(start.timestamp()) * 1_000_000, rng)
    spelling = Spelling(number)
    tracks = []
    next_vru, next_vehicle = 0, 1000
    for traveller, motion in zip(cast, motions, strict=True):
        if len(motion.step) < 50:
            continue
        vehicle = traveller.class_id in VEHICLE_CLASSES
        seen = detect(motion, 0.9 if vehicle else 0.45, rng)
        stamps = clock_us[motion.step[seen.index]]
        extent = traveller.extent_m if vehicle else None
        content = track_content(traveller.class_id, stamps, seen, extent, spelling, rng)
        tracks.append((next_vehicle if vehicle else next_vru, traveller.class_id, content))
        next_vehicle, next_vru = next_vehicle + vehicle, next_vru + (not vehicle)
    name = f"{number:04d}_{start:%Y%m%d_%H%M%S}"
    return _Sequence(name, tracks, clock_us, plan, spelling, rng)
