"""Several splits as one, for stacks that have learned from none of them."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from diffstack_mmv.checks import require
from diffstack_mmv.data.datamodule import TrajdataModule
from diffstack_mmv.data.dataset import WindowDataset
from diffstack_mmv.types import StackBatch, Tracks, map_tensors
from dmmv_conventions.cache import SPLITS

ALL = "all"
"""In place of a split: all of them."""


class JoinedWindows(WindowDataset):
    """The samples of some data sets, one after the other."""

    def __init__(self, parts: Sequence[WindowDataset]) -> None:
        """Join `parts` in their order.

        Raises:
            ValueError: There is none.
        """
        require(len(parts) > 0, "parts", "hold at least one data set", 0)
        self.parts = tuple(parts)
        self._first = np.cumsum([0, *(len(part) for part in parts)])

    def __len__(self) -> int:
        """Number of samples."""
        return int(self._first[-1])

    def __getitem__(self, index: Sequence[int]) -> StackBatch:
        """Return the samples of these numbers; neighbors are as many as in the fullest of them."""
        numbers = np.asarray(index, dtype=np.int64)
        owner = np.searchsorted(self._first, numbers, "right") - 1
        order = np.argsort(owner, kind="stable")
        batches = [
            self.parts[part][(numbers[owner == part] - self._first[part]).tolist()]
            for part in sorted(set(owner.tolist()))
        ]
        back = torch.from_numpy(np.argsort(order, kind="stable"))
        return map_tensors(lambda tensor: tensor[back], _concatenated(batches))

    @cached_property
    def samples(self) -> pd.DataFrame:
        """One row per sample, as in the parts."""
        return pd.concat([part.samples for part in self.parts], ignore_index=True)


def split_windows(data: TrajdataModule, split: str) -> WindowDataset:
    """Samples of a split, or of `ALL` of them, exported where they are not yet.

    Raises:
        ValueError: A split cannot be opened or holds no window.
    """
    splits = list(SPLITS) if split == ALL else [split]
    data.prepare_splits(splits)
    return JoinedWindows([data.dataset(each) for each in splits])


def _concatenated(batches: Sequence[StackBatch]) -> StackBatch:
    """One batch of several, their neighbors padded to the largest number."""
    widest = max(batch.neighbors_past.mode.shape[1] for batch in batches)
    padded = [
        batch._replace(
            neighbors_past=_padded(batch.neighbors_past, widest),
            neighbors_future=_padded(batch.neighbors_future, widest),
        )
        for batch in batches
    ]
    columns = [iter(_tensors(batch)) for batch in padded[1:]]
    return map_tensors(
        lambda tensor: torch.cat([tensor, *(next(column) for column in columns)]), padded[0]
    )


def _tensors(batch: StackBatch) -> list[Tensor]:
    found: list[Tensor] = []
    map_tensors(lambda tensor: found.append(tensor) or tensor, batch)
    return found


def _padded(neighbors: Tracks, widest: int) -> Tracks:
    missing = widest - neighbors.mode.shape[1]
    return map_tensors(
        lambda field: torch.cat([field, field.new_zeros(len(field), missing, *field.shape[2:])], 1),
        neighbors,
    )
