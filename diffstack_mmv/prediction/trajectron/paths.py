"""How well a mixture of Gaussian paths foretold what happened: likelihood and energy score."""

from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from diffstack_mmv.geometry import VARIANCE_FLOOR, scale_from_covariance
from diffstack_mmv.prediction.trajectron.blocks import Blocks, library
from diffstack_mmv.prediction.trajectron.energy import energy_of_paths
from diffstack_mmv.prediction.trajectron.mixture import PositionMoments
from diffstack_mmv.types import COUNTING_SHARE, log_density, on_host
from dmmv_conventions.libraries import counts, pointers


class PathScores(NamedTuple):
    """Scores of the components of rows, and of their mixture."""

    log_density: Float[Tensor, "S K"]  # of the truth at all valid times, in nats
    energy: Float[Tensor, " S"]  # see `energy_of_paths`, in m; zero where it was not asked for


def path_scores(
    moments: PositionMoments,
    log_weight: Float[Tensor, "S K"] | None,
    truth: Float[Tensor, "S T 2"],
    valid: Bool[Tensor, "S T"],
    blocks: Blocks | None = None,
) -> PathScores:
    """Score components `S K T`; in one call, and differentiable once, where `blocks` can.

    Args:
        moments: Mean and covariance of the positions of each component.
        log_weight: Log weights of the components, for the energy score; None: without.
        truth: What happened, in m.
        valid: Where that is known.
        blocks: Takes rows together where it can; None: tensors.
    """
    if blocks is not None and _fit(blocks, moments, log_weight, truth, valid):
        weight = log_weight.exp() if log_weight is not None else None
        given = (field.to(moments.mean.dtype) for field in (valid, truth))
        return PathScores(*_Scores.apply(*given, *moments, weight))  # type: ignore[no-untyped-call]
    error = truth.unsqueeze(1) - moments.mean
    each = log_density(error, scale_from_covariance(moments.covariance))
    each = torch.where(valid.unsqueeze(1), each, torch.zeros_like(each))
    if log_weight is None:
        return PathScores(each.sum(-1), each.new_zeros(len(each)))
    return PathScores(each.sum(-1), energy_of_paths(log_weight, moments.mean, truth, valid))


def _fit(
    blocks: Blocks, moments: PositionMoments, weight: Tensor | None, truth: Tensor, valid: Tensor
) -> bool:
    """Whether there is a library, and all have the sizes that it takes from the means."""
    mean, covariance = moments
    weights = [] if weight is None else [weight]
    if not blocks.fit(mean, covariance, *weights) or mean.dim() != 4:
        return False
    rows, components, steps, _ = mean.shape
    fits = on_host(truth, valid) and covariance.shape == (*mean.shape, 2)
    fits = fits and truth.shape == (rows, steps, 2) and valid.shape == (rows, steps)
    return fits and all(each.shape == (rows, components) for each in weights)


class _Scores(torch.autograd.Function):
    """`path_scores` in a library."""

    @staticmethod
    def forward(
        ctx: Any, valid: Tensor, truth: Tensor, *mixture: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        given = [each if each is None else each.contiguous() for each in (valid, truth, *mixture)]
        known, mean = truth.new_tensor([VARIANCE_FLOOR, COUNTING_SHARE]).to(truth.dtype), given[2]
        rows, components, steps, _ = mean.shape  # type: ignore[union-attr]
        ctx.counts = rows, torch.get_num_threads(), components, steps
        found = truth.new_empty(rows, components), truth.new_empty(rows)
        library(truth.dtype).dmmv_paths(*counts(*ctx.counts), *pointers(known, *given, *found))
        ctx.save_for_backward(known, *given)
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        *_, mean, covariance, weight = given = ctx.saved_tensors
        found = [
            torch.empty_like(each) if each is not None else None
            for each in (mean, covariance, weight)
        ]
        slopes = [each.contiguous() for each in grads]  # held until the call is over
        adjoint = library(mean.dtype).dmmv_paths_adjoint
        adjoint(*counts(*ctx.counts), *pointers(*given, *slopes, *found))
        return None, None, *found
