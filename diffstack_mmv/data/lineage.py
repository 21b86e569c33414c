"""Which recordings a stack learned from, so that it is not judged on them by mistake."""

from collections.abc import Mapping, Sequence

import pandas as pd

from diffstack_mmv.checks import require
from dmmv_conventions.data_names import family_of

Recordings = Mapping[str, Sequence[str]]
"""Names of scenes by the name of their data set, and of recordings that others of its family hold.

Data sets of a family are the same recordings with other splits, as `eth_ucy_eth` and
`eth_ucy_hotel`.
"""

RELEASES = {"imptc": "imptc_vru", "imptc_vru": "imptc"}
"""Other data set that was cut from the same recordings, whose names do not tell from which."""
SHOWN = 5
"""Names of recordings in one message."""


def recordings_of(samples: pd.DataFrame) -> dict[str, list[str]]:
    """Recordings that windows come from, sorted.

    Args:
        samples: One row per window with dataset, scene and recording, see `WindowDataset.samples`;
            without the last, a scene is one.
    """
    return {
        name: sorted({*rows["scene"], *(rows["recording"] if family_of(name) != name else ())})
        for name, rows in _scenes(samples)
    }


def joined_recordings(first: Recordings, second: Recordings) -> dict[str, list[str]]:
    """All recordings of both, sorted."""
    names = sorted(first.keys() | second.keys())
    return {name: sorted({*first.get(name, ()), *second.get(name, ())}) for name in names}


def seen_recordings(samples: pd.DataFrame, learned_from: Recordings) -> list[str]:
    """Recordings of windows that are among those that a stack learned from, as "dataset/scene".

    Of what it learned under another name of the family, that is the whole recording.

    Args:
        samples: One row per window, as in `recordings_of`.
        learned_from: What the stack learned from.
    """
    seen: list[str] = []
    for name, rows in _scenes(samples):
        kin = [other for other in learned_from if family_of(other) == family_of(name) != other]
        elsewhere = {each for other in kin if other != name for each in learned_from[other]}
        known = rows["scene"].isin([*learned_from.get(name, ())])
        known |= rows["recording"].isin([*elsewhere])
        seen += [f"{name}/{scene}" for scene in sorted(rows["scene"][known])]
    return seen


def other_releases(samples: pd.DataFrame, learned_from: Recordings) -> list[str]:
    """Data sets that a stack learned from, of which the windows are another release.

    Whether single recordings are the same is not known; `data.other_release` of a conversion is.

    Args:
        samples: One row per window, as in `recordings_of`.
        learned_from: What the stack learned from.
    """
    others = {RELEASES.get(name) for name, _ in _scenes(samples)}
    return [name for name in learned_from if name in others]


def _scenes(samples: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """By data set one row per scene of windows: scene, recording."""
    told = samples if "recording" in samples else samples.assign(recording=samples["scene"])
    scenes = told[["dataset", "scene", "recording"]].astype(str).drop_duplicates()
    return [(str(name), rows) for name, rows in scenes.groupby("dataset")]


def require_unseen(argument: str, split: str, seen: Sequence[str]) -> None:
    """Refuse a split with recordings that a stack learned from, such as one that was dealt anew.

    Args:
        argument: Name of what gives the split.
        split: The split.
        seen: Its recordings among those of the training, see `seen_recordings`.

    Raises:
        ValueError: There are some.
    """
    names = ", ".join(seen[:SHOWN]) + (", ..." if len(seen) > SHOWN else "")
    found = f"{len(seen)} of them in '{split}': {names}"
    remedy = (
        "Convert the data with the split of the training, train again with this one, or give "
        "allow_seen=true if it is meant so."
    )
    needs = "hold no recording that the checkpoint learned from"
    require(not seen, argument, needs, found, "", remedy)
