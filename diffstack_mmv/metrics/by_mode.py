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
    batches and processes. A score that is NaN for a sample leaves that sample out of its mean.

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
        self.total: Tensor
        self.count: Tensor

    def update(self, scores: Mapping[str, Float[Tensor, " B"]], mode: Int[Tensor, " B"]) -> None:
        """Add a batch of samples."""
        values = torch.stack([scores[name].detach().to(self.total) for name in self.names])
        known = ~torch.isnan(values)
        self.total.index_add_(1, mode, torch.where(known, values, 0.0))
        self.count.index_add_(1, mode, known.to(self.count))

    def compute(self) -> dict[str, Tensor]:
        """Means as `score` over all samples and `mode/score` over those of a mode.

        Absent where there was no sample.
        """
        means: dict[str, Tensor] = {}
        overall = self.total.sum(1) / self.count.sum(1)
        for row, name in enumerate(self.names):
            if self.count[row].sum() > 0:
                means[name] = overall[row].float()
            for mode in Mode:
                if self.count[row, mode] > 0:
                    means[f"{mode.label}/{name}"] = (
                        self.total[row, mode] / self.count[row, mode]
                    ).float()
        return means
