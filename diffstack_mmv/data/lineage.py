"""Which recordings a stack learned from, so that it is not judged on them by mistake."""

from collections.abc import Mapping, Sequence

import pandas as pd

from diffstack_mmv.checks import require

Recordings = Mapping[str, Sequence[str]]
"""Names of scenes by the name of their data set."""

SHOWN = 5
"""Names of recordings in one message."""


def recordings_of(samples: pd.DataFrame) -> dict[str, list[str]]:
    """Recordings that windows come from, sorted.

    Args:
        samples: One row per window with dataset and scene, see `WindowDataset.samples`.
    """
    scenes = samples[["dataset", "scene"]].astype(str).drop_duplicates()
    return {str(name): sorted(rows["scene"]) for name, rows in scenes.groupby("dataset")}


def joined_recordings(first: Recordings, second: Recordings) -> dict[str, list[str]]:
    """All recordings of both, sorted."""
    names = sorted(first.keys() | second.keys())
    return {name: sorted({*first.get(name, ()), *second.get(name, ())}) for name in names}


def seen_recordings(samples: pd.DataFrame, learned_from: Recordings) -> list[str]:
    """Recordings of windows that are among those that a stack learned from, as "dataset/scene".

    Args:
        samples: One row per window, as in `recordings_of`.
        learned_from: What the stack learned from.
    """
    return [
        f"{name}/{scene}"
        for name, scenes in recordings_of(samples).items()
        for scene in sorted({*scenes} & {*learned_from.get(name, ())})
    ]


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
