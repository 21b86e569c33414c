"""A proper score of a mixture of paths in metres, beside the likelihood."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.smooth import safe_norm
from diffstack_mmv.types import COUNTING_SHARE


def energy_of_paths(
    log_weight: Float[Tensor, "*b K"],
    mean: Float[Tensor, "*b K T 2"],
    truth: Float[Tensor, "*b T 2"],
    valid: Bool[Tensor, "*b T"],
) -> Float[Tensor, "*b"]:
    """Energy score of the mixture of the components' means in m, mean over the valid times.

        Σ_k w_k |μ_kt - y_t| - 1/2 Σ_k Σ_l w_k w_l |μ_kt - μ_lt|

    The likelihood of a whole path is a product over times that are far from independent: it moves
    weights and means by what the noise of every step says. This score moves them by metres, so the
    path of the mixture with the least expected distance comes closer to the truth. It is zero only
    for the truth, and in the mean no mixture beats the true distribution. Means of components with
    less than `COUNTING_SHARE` get no gradient, their weights do. Source: Gneiting and Raftery,
    Strictly Proper Scoring Rules, Prediction, and Estimation, 2007.

    Args:
        log_weight: Log weights w of the components.
        mean: Their paths μ in m.
        truth: What happened, y, in m.
        valid: Where that is known.

    Returns:
        The score; zero where no time is valid.
    """
    weight = log_weight.exp()
    counts = (weight >= COUNTING_SHARE)[..., None, None]
    path = torch.where(counts, mean, mean.detach())
    missed = safe_norm(path - truth.unsqueeze(-3))
    components = mean.shape[-3]
    first, second = torch.triu_indices(components, components, 1, device=mean.device)  # all pairs
    apart = safe_norm(path[..., first, :, :] - path[..., second, :, :])
    both = weight[..., first] * weight[..., second]
    each = (weight.unsqueeze(-1) * missed).sum(-2) - (both.unsqueeze(-1) * apart).sum(-2)
    return torch.where(valid, each, 0.0).sum(-1) / valid.sum(-1).clamp_min(1)
