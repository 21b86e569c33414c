"""Which files repeat samples of others, and which therefore belong to one recording."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

RUN = 10
"""Samples in a row, both coordinates equal to the centimetre, that cannot agree by chance."""

Array = NDArray[np.float64]


def find_contained(tracks: Mapping[str, Array]) -> dict[str, str]:
    """Tracks whose samples are all, in a row, part of a longer (or equal, earlier named) track.

    Args:
        tracks: By name (n, 2) positions in m.

    Returns:
        Name of a contained track and the name of the track that contains it.
    """
    starts: dict[bytes, list[tuple[str, int]]] = {}
    order = sorted(tracks, key=lambda name: (-len(tracks[name]), name))
    contained: dict[str, str] = {}
    for name in order:
        samples = _centimetres(tracks[name])
        head = samples[:RUN].tobytes()
        for holder, index in starts.get(head, []):
            piece = _centimetres(tracks[holder])[index : index + len(samples)]
            if np.array_equal(piece, samples):
                contained[name] = holder
                break
        else:
            for index in range(len(samples) - RUN + 1):
                starts.setdefault(samples[index : index + RUN].tobytes(), []).append((name, index))
    return contained


def group_recordings(tracks: Mapping[str, Array], recordings: Mapping[str, str]) -> dict[str, str]:
    """Name of the recording group of each track.

    Tracks belong together if they name the same recording or share `RUN` samples in a row.

    Args:
        tracks: By name (n, 2) positions in m.
        recordings: By name the recording that the file name states.

    Returns:
        By name the first recording, in sorted order, of its group.
    """
    parent: dict[str, str] = {recording: recording for recording in recordings.values()}

    def root(name: str) -> str:
        while parent[name] != name:
            parent[name] = parent[parent[name]]
            name = parent[name]
        return name

    owner: dict[bytes, str] = {}
    for name in sorted(tracks):
        samples = _centimetres(tracks[name])
        for index in range(len(samples) - RUN + 1):
            run = samples[index : index + RUN].tobytes()
            first, second = sorted(
                (root(owner.setdefault(run, recordings[name])), root(recordings[name]))
            )
            parent[second] = first
    return {name: root(recordings[name]) for name in tracks}


def _centimetres(samples: Array) -> NDArray[np.int64]:
    return np.ascontiguousarray(np.rint(samples * 100.0).astype(np.int64))
