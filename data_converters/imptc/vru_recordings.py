"""Which tracks of the IMPTC VRU-trajectory release belong together, and to which split."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from data_converters.imptc.vru_release import RELEASE_SPLITS, VruTrack
from data_converters.splits import RecordingSplit

PAUSE_US = 30_000_000
"""Tracks with shorter pauses between them are of one recording."""

LONGEST_US = 3_600_000_000
"""A track that claims to last longer has a broken clock, and joins nothing."""


def overlapping(tracks: list[VruTrack], *, pause_us: int) -> list[int]:
    """Group of each track, the number of one of its tracks: groups are `pause_us` apart in time.

    A track without a usable time is a group of its own.
    """
    groups = list(range(len(tracks)))
    timed = [n for n, t in enumerate(tracks) if 0 <= t.last_us - t.first_us <= LONGEST_US]
    group, until = -1, -math.inf
    for number in sorted(timed, key=lambda number: tracks[number].first_us):
        if tracks[number].first_us > until + pause_us:
            group = number
        groups[number] = group
        until = max(until, tracks[number].last_us)
    return groups


def connected(groups: list[int], sequences: list[str]) -> list[int]:
    """Groups joined where they hold tracks of one sequence; "" is none."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(groups)
    named = {sequence: number for number, sequence in enumerate(dict.fromkeys(sequences), count)}
    links = [(g, named[s]) for g, s in zip(groups, sequences, strict=True) if s]
    ends = np.array(links, dtype=np.int64).reshape(-1, 2)
    size = count + len(named)
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(size, size))
    labels = connected_components(graph, directed=False)[1]
    return [int(labels[group]) for group in groups]


def recording_splits(
    recordings: list[int], tracks: list[VruTrack], known: Mapping[str, str]
) -> dict[int, str]:
    """Split of each recording: the published one if its tracks share it, else that of its sequence.

    `known` are the splits of sequences in the other release; the rest is dealt.
    """
    published: dict[int, list[str]] = {}
    first: dict[int, VruTrack] = {}
    for recording, track in zip(recordings, tracks, strict=True):
        published.setdefault(recording, []).append(RELEASE_SPLITS[track.key.partition("/")[0]])
        first.setdefault(recording, track)
    mixed = {r: float(len(splits)) for r, splits in published.items() if len(set(splits)) > 1}
    dealt = RecordingSplit().deal({first[r].key: size for r, size in mixed.items()})
    return {r: splits[0] for r, splits in published.items()} | {
        r: known.get(first[r].sequence, dealt[first[r].key]) for r in mixed
    }
