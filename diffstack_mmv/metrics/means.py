"""Means over what can be judged.

A sample that cannot be judged is NaN among per-sample values; no gradient passes through it.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor


def where_known(values: Float[Tensor, "*b"], known: Bool[Tensor, "*#b"]) -> Float[Tensor, "*b"]:
    """Keep the values that are known, in their unit; the others are NaN."""
    return torch.where(known, values, torch.nan)


def time_mean(values: Float[Tensor, "*b T"], valid: Bool[Tensor, "*#b T"]) -> Float[Tensor, "*b"]:
    """Mean over the valid times, in the unit of the values; NaN where no time is valid."""
    count = valid.sum(-1)
    total = torch.where(valid, values, torch.zeros_like(values)).sum(-1)
    return where_known(total / count.clamp_min(1), count > 0)


def masked_mean(values: Float[Tensor, "*b"], counted: Bool[Tensor, "*#b"]) -> Float[Tensor, ""]:
    """Mean over samples for a training loss.

    Args:
        values: One number per sample.
        counted: Samples that count; what stands in the others does not matter. A NaN that counts
            is told as such, since a loss must not hide that it diverged.

    Returns:
        Mean over the samples that count, in the unit of the values; zero without gradient where
        there is none, so that a loss stays finite.
    """
    total = torch.where(counted, values, torch.zeros_like(values)).sum()
    return total / counted.sum().clamp_min(1)
