"""The pieces of an export that processes write side by side."""

from pathlib import Path

import numpy as np
import torch
from torch.utils.data import Dataset

from diffstack_mmv.data.batch import stack_batch
from diffstack_mmv.data.faults import passing_faults
from diffstack_mmv.data.layout import FieldLayout, pack, write_windows
from diffstack_mmv.data.registration import TrajdataWindows, WindowLocation
from diffstack_mmv.data.riding import Situations, situations

CHUNK = 512  # windows per task: what is lost when an export is interrupted
PIECE = 64  # windows in memory at once

LABELS = {
    "usable": FieldLayout((), np.bool_),
    "situations": FieldLayout((len(Situations._fields),), np.bool_),
}


class ChunkWriter(Dataset[int]):
    """Item k writes the k-th chunk of windows and returns k; workers are forked."""

    def __init__(self, source: TrajdataWindows, where: WindowLocation, folder: Path) -> None:
        self._source = source
        self._element = where.element
        self._folder = folder
        self._collate = source.get_collate_fn()

    def __len__(self) -> int:
        return -(-len(self._element) // CHUNK)

    def size(self, number: int) -> int:
        """Windows in a chunk."""
        return min(CHUNK, len(self._element) - number * CHUNK)

    def marker(self, number: int) -> Path:
        """File that says that a chunk is written."""
        return self._folder / "done" / str(number)

    @passing_faults
    def __getitem__(self, number: int) -> int:
        end = number * CHUNK + self.size(number)
        for first in range(number * CHUNK, end, PIECE):
            self._write(first, min(first + PIECE, end))
        return number

    def _write(self, first: int, end: int) -> None:
        elements = [self._source[int(element)] for element in self._element[first:end]]
        batch = stack_batch(self._collate(elements), self._source.windows)
        usable = batch.ego_past.valid.all(-1) & batch.ego_future.valid.all(-1)
        packed = pack(batch) | {
            "usable": usable.numpy(),
            "situations": torch.stack(situations(batch), -1).numpy(),
        }
        for name, content in packed.items():
            write_windows(self._folder / f"{name}.npy", first, content)
