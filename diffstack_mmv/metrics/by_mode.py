"""Means of per-sample scores by mode of transport, reduced over processes."""

from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torchmetrics import Metric

from diffstack_mmv.checks import require
from diffstack_mmv.types import Mode


class MeanByMode(Metric):
    """Mean of each score over the samples of each mode, and over all samples.

    The states are sums and counts, so the result does not depend on how samples are spread over
    batches and processes. A score that is NaN for a sample leaves that sample out of its mean;
    samples that some score could not judge are counted.

    Args:
        names: The scores.

    Raises:
        ValueError: No score is named.
    """

    full_state_update = False

    def __init__(self, names: Sequence[str]) -> None:
        super().__init__()
        require(len(names) > 0, "names", "hold at least one score", list(names))
        self.names = list(names)
        shape = (len(self.names), len(Mode))
        self.add_state("total", torch.zeros(shape, dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("count", torch.zeros(shape, dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("samples", torch.zeros(len(Mode), dtype=torch.int64), dist_reduce_fx="sum")
        self.add_state("missing", torch.zeros(len(Mode), dtype=torch.int64), dist_reduce_fx="sum")
        self.total: Tensor
        self.count: Tensor
        self.samples: Tensor
        self.missing: Tensor

    def update(self, scores: Mapping[str, Float[Tensor, " B"]], mode: Int[Tensor, " B"]) -> None:
        """Add a batch of samples."""
        values = torch.stack([scores[name].detach().to(self.total) for name in self.names])
        known = ~torch.isnan(values)
        self.total.index_add_(1, mode, torch.where(known, values, 0.0))
        self.count.index_add_(1, mode, known.to(self.count))
        self.samples.index_add_(0, mode, torch.ones_like(mode).to(self.samples))
        self.missing.index_add_(0, mode, (~known.all(0)).to(self.missing))

    def compute(self) -> dict[str, Tensor]:
        """Means of shape () as `score` over all samples and `mode/score` over those of a mode.

        Absent where no sample could be judged. `n_missing` and `mode/n_missing` count the samples
        that at least one score could not judge.
        """
        # the counts in one copy: to ask a device for each of them would make it wait as often
        samples, counts = self.samples.tolist(), self.count.tolist()
        present = {mode: f"{mode.label}/" for mode in Mode if samples[mode] > 0}
        means: dict[str, Tensor] = {}
        for row, name in enumerate(self.names):
            if sum(counts[row]) > 0:
                means[name] = (self.total[row].sum() / self.count[row].sum()).float()
            for mode, prefix in present.items():
                if counts[row][mode] > 0:
                    mean = self.total[row, mode] / self.count[row, mode]
                    means[f"{prefix}{name}"] = mean.float()
        if present:
            means["n_missing"] = self.missing.sum().float()
        return means | {
            f"{prefix}n_missing": self.missing[mode].float() for mode, prefix in present.items()
        }
