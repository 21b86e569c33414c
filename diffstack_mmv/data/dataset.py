"""Samples by number: from an export on disk, or straight from trajdata."""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from jaxtyping import Int
from numpy.typing import NDArray
from pyarrow.lib import ArrowException
from torch import Tensor
from torch.utils._pytree import tree_leaves
from torch.utils.data import Dataset

from diffstack_mmv.checks import message, require
from diffstack_mmv.data.batch import stack_batch
from diffstack_mmv.data.layout import PER_NEIGHBOR, FieldLayout, fields, unpack
from diffstack_mmv.data.registration import TrajdataWindows, WindowLocation
from diffstack_mmv.data.settings import WindowSettings
from diffstack_mmv.types import StackBatch

EXPORT_VERSION = 4
MARKER = "export.json"
SAMPLES = "samples.parquet"
USABLE = "usable.npy"
PIECE = 256  # samples in memory at once while they are hashed


class WindowDataset(Dataset[StackBatch], ABC):
    """Samples by number; an item is a whole batch, given the numbers of its samples."""

    @abstractmethod
    def __len__(self) -> int:
        """Number of samples."""

    @abstractmethod
    def __getitem__(self, index: Sequence[int]) -> StackBatch:
        """Return the samples of these numbers, in this order."""

    @property
    @abstractmethod
    def samples(self) -> pd.DataFrame:
        """One row per sample: dataset, scene, agent, row (time index), mode, recording."""

    def digest(self) -> str:
        """SHA-256 of all samples and of where they come from, hexadecimal."""
        # which scenes are of one recording changes no sample
        where = self.samples.drop(columns="recording", errors="ignore")
        digest = hashlib.sha256(where.to_csv(index=False).encode())
        for first in range(0, len(self), PIECE):
            batch = self[range(first, min(first + PIECE, len(self)))]
            for part in tree_leaves(batch):
                content = (
                    part.numpy().tobytes() if isinstance(part, Tensor) else repr(part).encode()
                )
                digest.update(content)
        return digest.hexdigest()

    @property
    def modes(self) -> Int[Tensor, " n"]:
        """Mode of the ego of each sample."""
        return torch.tensor(self.samples["mode"].to_numpy(np.int64))


class ExportedWindows(WindowDataset):
    """Samples of an export, read through memory maps."""

    def __init__(self, folder: Path) -> None:
        """Open an export.

        Raises:
            ValueError: The export is absent, incomplete, of another version or damaged.
        """
        self.folder = folder
        self.content = _marker(folder)
        self.windows = WindowSettings(**self.content["key"]["windows"])
        layout = fields(self.windows)
        self._usable = np.flatnonzero(self._map("usable", FieldLayout((), np.bool_)))
        self._fields = {name: self._map(name, shape) for name, shape in layout.items()}

    def _map(self, name: str, layout: FieldLayout) -> NDArray[Any]:
        path = self.folder / f"{name}.npy"
        wanted = (self.content["windows"], *layout.shape)
        try:
            array = np.load(path, mmap_mode="r")
        except (OSError, EOFError, ValueError) as error:
            raise ValueError(_damaged(path, f"be an array of shape {wanted}", error)) from error
        if array.shape != wanted or array.dtype != layout.dtype:
            needs = f"have shape {wanted} of {np.dtype(layout.dtype)}"
            raise ValueError(_damaged(path, needs, f"{array.shape} of {array.dtype}"))
        return array

    def __reduce__(self) -> tuple[type["ExportedWindows"], tuple[Path]]:
        """Send the folder to another process, not what the memory maps hold."""
        return ExportedWindows, (self.folder,)

    def __len__(self) -> int:
        """Number of samples."""
        return len(self._usable)

    def __getitem__(self, index: Sequence[int]) -> StackBatch:
        """Return the samples of these numbers; neighbors are as many as in the fullest of them."""
        chosen = self._usable[np.asarray(index, dtype=np.int64)]
        widest = int(self._fields["neighbors_count"][chosen].max(initial=0))
        read = {
            name: array[chosen, :widest] if name in PER_NEIGHBOR else array[chosen]
            for name, array in self._fields.items()
        }
        return unpack({name: torch.from_numpy(array) for name, array in read.items()}, self.windows)

    @cached_property
    def samples(self) -> pd.DataFrame:
        """One row per sample: dataset, scene, agent, row, mode, recording and the situations.

        In exports of before recordings were told, each scene is one.

        Raises:
            ValueError: The file is damaged, or of another export.
        """
        path = self.folder / SAMPLES
        try:
            table = pd.read_parquet(path)
        except (OSError, ValueError, ArrowException) as error:
            raise ValueError(_damaged(path, "be a table of the windows", error)) from error
        if len(table) != self.content["windows"]:
            raise ValueError(_damaged(path, "have a row per window", len(table)))
        table = table.iloc[self._usable].reset_index(drop=True)
        return table if "recording" in table else table.assign(recording=table["scene"])


class DirectWindows(WindowDataset):
    """The same samples straight from trajdata: slow, but nothing is written."""

    def __init__(self, source: TrajdataWindows, dataset: str) -> None:
        """Take all windows of `source`, the windows of `dataset`; NaN windows are not left out."""
        self.windows = source.windows
        self._source = source
        self._locations = source.locations()
        self._dataset = dataset
        self._collate = source.get_collate_fn()

    def __len__(self) -> int:
        """Number of samples."""
        return len(self._locations.element)

    def __getitem__(self, index: Sequence[int]) -> StackBatch:
        """Return the samples of these numbers; neighbors are as many as in the fullest of them."""
        numbers = self._locations.element[np.asarray(index, dtype=np.int64)]
        elements = [self._source[int(number)] for number in numbers]
        return stack_batch(self._collate(elements), self.windows)

    @cached_property
    def samples(self) -> pd.DataFrame:
        """One row per sample: dataset, scene, agent, row, mode, recording."""
        return sample_table(self._locations, self._dataset)


def sample_table(where: WindowLocation, dataset: str) -> pd.DataFrame:
    """Identity of each window: dataset, scene, agent, row (time index), mode, recording."""
    columns = ("scene", "agent", "row", "mode", "recording")
    return pd.DataFrame({"dataset": dataset} | {name: getattr(where, name) for name in columns})


def _marker(folder: Path) -> dict[str, Any]:
    path = folder / MARKER
    remedy = f"Delete {folder} and run again: it is made anew."
    if not path.is_file():
        raise ValueError(message("export", "be complete", "no such file", f"at {path}", remedy))
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ValueError(
            message("export", "have a marker in JSON", error, f"in {path}", remedy)
        ) from error
    found = content.get("version")
    require(found == EXPORT_VERSION, "version", f"be {EXPORT_VERSION}", found, f"in {path}", remedy)
    return content


def _damaged(path: Path, requirement: str, found: object) -> str:
    return message(
        "export", requirement, found, f"in {path}", f"Delete {path.parent} and run again."
    )
