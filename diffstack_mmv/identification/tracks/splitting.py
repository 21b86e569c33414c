"""Dividing segments into those that are fitted and those that validate the fit."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Generator

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.identification.tracks.segments import TrackSegment
from diffstack_mmv.identification.tracks.selection import SegmentSelection


class DataSplit(NamedTuple):
    """Segments to fit, and segments of other recordings to judge the fit by."""

    fitted: list[TrackSegment]
    heldout: list[TrackSegment]


def split_segments(
    segments: Sequence[TrackSegment],
    selection: SegmentSelection,
    fitted: int,
    heldout: int,
    seed: int,
) -> DataSplit:
    """Take the preferred segments and divide them at random, recordings kept together.

    With a single recording, its tracks are divided instead, and of a single track its segments.

    Args:
        segments: All segments.
        selection: Which to prefer.
        fitted: Number of segments to fit, at most.
        heldout: Number to hold out, at most.
        seed: Of the random numbers.

    Raises:
        ValueError: A number is below one, or there are fewer than two segments.
    """
    require_at_least("tracks", fitted, 1)
    require_at_least("heldout", heldout, 1)
    require_at_least("segments", len(segments), 2, remedy="One is fitted, one held out.")
    generator = Generator().manual_seed(seed)
    order = selection(segments, generator).argsort(descending=True).tolist()
    groups = _kept_together(segments)
    groups = groups if len({*groups}) > 1 else [each.name for each in segments]
    wanted = min(len(order), fitted + heldout)
    kept = max(1, min(heldout, round(wanted * heldout / (fitted + heldout)), wanted - 1))
    sizes = Counter(groups[index] for index in order[:wanted])
    drawn = _draw_groups(sizes, kept, generator)
    split = DataSplit([], [])
    for index in order:
        out = groups[index] in drawn
        part, limit = (split.heldout, heldout) if out else (split.fitted, fitted)
        if len(part) < limit:
            part.append(segments[index])
    return split


def _kept_together(segments: Sequence[TrackSegment]) -> list[str]:
    """The recording of each segment, or its track where there is one recording alone."""
    recordings = [each.recording for each in segments]
    return recordings if len({*recordings}) > 1 else [each.track for each in segments]


def _draw_groups(sizes: Counter[str], count: int, generator: Generator) -> set[str]:
    """Groups at random until they hold so many segments; one group is always left."""
    names, drawn = list(sizes), set()
    for index in torch.randperm(len(names), generator=generator).tolist()[:-1]:
        if sum(sizes[name] for name in drawn) < count:
            drawn.add(names[index])
    return drawn


def cross_validation_splits(split: DataSplit, count: int, seed: int) -> list[DataSplit]:
    """Divide all segments so that each is held out once, recordings kept together.

    With a single recording, its tracks are divided instead.

    Args:
        split: The segments.
        count: Number of folds; no more than there are recordings.
        seed: Of the random order of the recordings.

    Raises:
        ValueError: There are fewer than two folds or recordings.
    """
    require_at_least("folds", count, 2)
    segments = [*split.fitted, *split.heldout]
    owners = _kept_together(segments)
    recordings = sorted({*owners})
    require_at_least("recordings", len(recordings), 2, remedy="One is held out at a time.")
    order = torch.randperm(len(recordings), generator=Generator().manual_seed(seed)).tolist()
    fold = {recordings[index]: place % count for place, index in enumerate(order)}
    return [
        DataSplit(
            [each for each, owner in zip(segments, owners, strict=True) if fold[owner] != part],
            [each for each, owner in zip(segments, owners, strict=True) if fold[owner] == part],
        )
        for part in range(min(count, len(recordings)))
    ]
