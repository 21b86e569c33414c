"""Order of the samples: a function of seed and epoch, shared out among processes, resumable."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.utils.data import DistributedSampler

from diffstack_mmv.checks import require, require_at_least, require_between, require_one_of
from diffstack_mmv.data.riding import Situations


class Draw(NamedTuple):
    """One batch to be read."""

    indices: list[int]
    seed: int  # of whatever is random about the batch


class Share(NamedTuple):
    """Which part of the samples this process takes."""

    rank: int = 0
    processes: int = 1


@runtime_checkable
class Balance(Protocol):
    """Chooses how often samples are drawn in training."""

    def weights(self, samples: pd.DataFrame) -> Float[Tensor, " n"]:
        """Relative frequency of each sample; `samples` as `WindowDataset.samples` tells them."""
        ...


@dataclass(frozen=True)
class EqualModes:
    """Every mode of the ego is drawn equally often."""

    def weights(self, samples: pd.DataFrame) -> Float[Tensor, " n"]:
        """One over the number of samples of the same mode."""
        modes = torch.tensor(samples["mode"].to_numpy(np.int64))
        return 1.0 / modes.bincount()[modes].double()


@dataclass(frozen=True)
class SituationShare:
    """Samples in one situation make up a given share; half of many recordings is standstill.

    Attributes:
        situation: A field of `Situations`.
        share: Share of the draws in [0, 1].

    Raises:
        ValueError: There is no such situation, or the share is not between 0 and 1.
    """

    situation: str = "moving"
    share: float = 0.75

    def __post_init__(self) -> None:
        require_one_of("situation", self.situation, Situations._fields)
        require_between("share", self.share, 0.0, 1.0)

    def weights(self, samples: pd.DataFrame) -> Float[Tensor, " n"]:
        """Weights that add up to `share` inside of the situation, and to the rest outside.

        Raises:
            ValueError: The samples carry no situations, or all or none are in this one.
        """
        known = self.situation in samples
        require(known, "samples", "carry situations", list(samples), "", "Set an export folder.")
        inside = torch.tensor(samples[self.situation].to_numpy(bool))
        count = int(inside.sum())
        mixed = 0 < count < len(inside)
        require(
            mixed, "situation", "hold for some samples, not for all", f"{count} of {len(inside)}"
        )
        return torch.where(
            inside, self.share / count, (1.0 - self.share) / (len(inside) - count)
        ).double()


class WindowSampler(DistributedSampler[Draw], ABC):
    """Batches of sample numbers for one process.

    It is a `DistributedSampler`, so that Lightning takes it as it is in every strategy.
    """

    def __init__(self, count: int, batch_size: int, seed: int, share: Share) -> None:
        """Share out `count` samples.

        Raises:
            ValueError: There is no sample or the batch size is not positive.
        """
        require_at_least("count", count, 1)
        require_at_least("batch_size", batch_size, 1)
        super().__init__(range(count), share.processes, share.rank, shuffle=False, seed=seed)  # type: ignore[arg-type]
        self.count = count
        self.batch_size = batch_size
        self.share = share
        self.start = 0

    @abstractmethod
    def order(self) -> Int[Tensor, " n"]:
        """Numbers of this process's samples in the present epoch."""

    @property
    @abstractmethod
    def share_size(self) -> int:
        """How many samples this process takes in an epoch."""

    @property
    def fewest(self) -> int:
        """Batches of a whole epoch in the process that takes fewest."""
        return -(-(self.count // self.share.processes) // self.batch_size)

    def __len__(self) -> int:
        """Batches of a whole epoch, wherever it starts."""
        return -(-self.share_size // self.batch_size)

    def __iter__(self) -> Iterator[Draw]:
        """Batches of the present epoch, from batch `start` on."""
        batches = self.order().split(self.batch_size)
        for number in range(self.start, len(batches)):
            entropy = [self.seed, self.epoch, number, self.share.rank]
            seed = int(np.random.SeedSequence(entropy).generate_state(1)[0])
            yield Draw(batches[number].tolist(), seed)

    def set_epoch(self, epoch: int) -> None:
        """Go to an epoch; another one than the present starts at its first batch."""
        if epoch != self.epoch:
            self.start = 0
        super().set_epoch(epoch)


class TrainingSampler(WindowSampler):
    """A new random order in each epoch; with weights, draws with replacement.

    With several processes the last few samples of the order are left out, so that all processes
    take equally many steps; which ones changes with the epoch.
    """

    def __init__(
        self,
        count: int,
        batch_size: int,
        seed: int,
        share: Share,
        weights: Float[Tensor, " n"] | None = None,
    ) -> None:
        """Share out `count` samples; weights, if any, tell how often each is drawn."""
        super().__init__(count, batch_size, seed, share)
        self._weights = weights

    @property
    def share_size(self) -> int:
        """How many samples this process takes in an epoch."""
        return self.count // self.share.processes

    def order(self) -> Int[Tensor, " n"]:
        """Every process computes the whole order and takes each `processes`-th entry of it."""
        entropy = np.random.SeedSequence([self.seed, self.epoch]).generate_state(1)
        generator = torch.Generator().manual_seed(int(entropy[0]))
        if self._weights is None:
            whole = torch.randperm(self.count, generator=generator)
        else:
            whole = torch.multinomial(
                self._weights, self.count, replacement=True, generator=generator
            )
        used = self.share_size * self.share.processes
        return whole[self.share.rank : used : self.share.processes]


class EvaluationSampler(WindowSampler):
    """Every sample exactly once, in order.

    The shares of several processes may differ by one sample: metrics synchronise when they are
    computed, not at each batch, so their values are those of one process.
    """

    @property
    def share_size(self) -> int:
        """How many samples this process takes."""
        return len(range(self.share.rank, self.count, self.share.processes))

    def order(self) -> Int[Tensor, " n"]:
        """Each `processes`-th sample."""
        return torch.arange(self.share.rank, self.count, self.share.processes)
