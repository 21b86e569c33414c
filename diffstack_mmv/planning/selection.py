"""Which candidate is closest to what the human did, and the cross entropy of choosing it."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor


def closest_candidate(
    positions: Float[Tensor, "*b C T 2"],
    human: Float[Tensor, "*b T 2"],
    valid: Bool[Tensor, "*b T"],
) -> Int[Tensor, "*b"]:
    """Index of the candidate with the smallest mean squared distance (m²) from the human.

    Rows that are not valid count for nothing, whatever stands in them.
    """
    error = (positions - human.unsqueeze(-3)).square().sum(-1)
    return torch.where(valid.unsqueeze(-2), error, 0.0).sum(-1).argmin(-1)


def cross_entropy(logits: Float[Tensor, "*b C"], target: Int[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Cross entropy in nats of the softmax over candidates against the chosen one."""
    return -torch.log_softmax(logits, -1).take_along_dim(target.unsqueeze(-1), -1).squeeze(-1)
