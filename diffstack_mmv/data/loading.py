"""Data loader whose position within an epoch is part of a checkpoint."""

import math
from collections.abc import Iterator
from typing import TypeVar

import torch
from torch.utils.data import DataLoader, Dataset

from diffstack_mmv.checks import require
from diffstack_mmv.data.augment import Augmentation
from diffstack_mmv.data.dataset import WindowDataset
from diffstack_mmv.data.faults import passing_faults, raising_faults
from diffstack_mmv.data.sampling import Draw, WindowSampler
from diffstack_mmv.types import StackBatch

Item = TypeVar("Item")


class DrawnWindows(Dataset[StackBatch]):
    """Batches as a sampler draws them, augmented with the seed of the draw."""

    def __init__(self, windows: WindowDataset, augmentation: Augmentation | None = None) -> None:
        """Read from `windows`."""
        self.windows = windows
        self.augmentation = augmentation

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.windows)

    @passing_faults
    def __getitem__(self, draw: Draw) -> StackBatch:
        """Return a batch; its augmentation depends on the draw only, not on the worker."""
        batch = self.windows[draw.indices]
        if self.augmentation is None:
            return batch
        return self.augmentation(batch, torch.Generator().manual_seed(draw.seed))


class WindowLoader(DataLoader[StackBatch]):
    """Loads batches; Lightning keeps its state in checkpoints and resumes within an epoch."""

    sampler: WindowSampler

    def __init__(self, dataset: DrawnWindows, sampler: WindowSampler, workers: int) -> None:
        """Load in `workers` forked processes, into pinned memory if there is a CUDA device."""
        super().__init__(
            dataset,
            batch_size=None,
            sampler=sampler,
            num_workers=workers,
            collate_fn=unchanged,  # type: ignore[arg-type]
            # else each epoch would draw a seed for the workers from the generator of the training
            generator=torch.Generator(),
            pin_memory=torch.cuda.is_available(),
            persistent_workers=workers > 0,
            multiprocessing_context="fork" if workers else None,
        )
        self._taken = 0

    def __iter__(self) -> Iterator[StackBatch]:  # type: ignore[override]
        """Batches of the present epoch, from where a loaded state stopped.

        Raises:
            ValueError: A file of the data set is damaged.
        """
        self._taken = self.sampler.start
        for batch in raising_faults(super().__iter__()):
            # counted when handed out: workers are further ahead than the training step
            self._taken += 1
            yield batch
        self._taken = self.sampler.start = 0

    def state_dict(self) -> dict[str, int]:
        """Epoch, batches handed out in it, and what must be equal on resuming."""
        return {"epoch": self.sampler.epoch, "batches": self._taken, **self._setting()}

    def load_state_dict(self, state_dict: dict[str, int]) -> None:
        """Go on behind the last batch that was handed out.

        Raises:
            ValueError: Seed, batch size, number of processes or of samples are others.
        """
        for name, value in self._setting().items():
            found = state_dict.get(name)
            remedy = "Resume with the settings of the checkpoint."
            require(found == value, name, f"be {found} as in the checkpoint", value, "", remedy)
        self.sampler.set_epoch(state_dict["epoch"])
        self._taken = self.sampler.start = state_dict["batches"]

    def _setting(self) -> dict[str, int]:
        return {
            "seed": self.sampler.seed,
            "batch_size": self.sampler.batch_size,
            "processes": self.sampler.share.processes,
            "samples": self.sampler.count,
        }


def require_a_batch(argument: str, share: float, batches: int) -> None:
    """Refuse a share of the batches of an epoch that holds none of them.

    Args:
        argument: Name of the setting.
        share: A share in (0, 1], or a whole number of batches.
        batches: Batches of the epoch, of the process that takes fewest.

    Raises:
        ValueError: Not one batch is left.
    """
    if isinstance(share, float) and int(share * batches) == 0 < batches:
        least = math.ceil(1e3 / batches) / 1e3
        needs = f"be at least {least:g}, one of {batches} batches"
        require(False, argument, needs, share, "", "A whole number N takes the first N batches.")


def unchanged(item: Item) -> Item:
    """What the workers made, as it is: items are whole batches, and nothing is left to collate."""
    return item
