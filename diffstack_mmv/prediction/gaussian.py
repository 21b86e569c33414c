"""Gaussians in the plane, in closed form: no library call per 2×2 matrix."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.geometry import direction, left_of


def covariance_along(
    course: Float[Tensor, "*b"], along: Float[Tensor, "*b"], across: Float[Tensor, "*b"]
) -> Float[Tensor, "*b 2 2"]:
    """Covariance in m² of errors with standard deviations in m along and across a course in rad."""
    forward = direction(course)
    left = left_of(forward)
    axes = torch.stack([along.unsqueeze(-1) * forward, across.unsqueeze(-1) * left], -1)
    return axes @ axes.mT


def rotate_covariance(
    covariance: Float[Tensor, "*b 2 2"], angle: Float[Tensor, "*#b"]
) -> Float[Tensor, "*b 2 2"]:
    """Covariance R Σ Rᵀ of a vector that was rotated counter-clockwise by an angle in rad."""
    cosine, sine = angle.cos().unsqueeze(-1), angle.sin().unsqueeze(-1)
    first, second = covariance.unbind(-2)
    rows = cosine * first - sine * second, sine * first + cosine * second
    turned = [(row[..., 0], row[..., 1]) for row in rows]
    cosine, sine = cosine.squeeze(-1), sine.squeeze(-1)
    entries = [torch.stack([cosine * x - sine * y, sine * x + cosine * y], -1) for x, y in turned]
    return torch.stack(entries, -2)


def log_of_sum(log_joint: Float[Tensor, "*b K"]) -> Float[Tensor, "*b"]:
    """Log in nats of the sum over K components, to the digit that rounding leaves.

    A component that is too small for it has no part in the gradient either, so that nothing needs
    to be differentiated through it.
    """
    largest = log_joint.detach().amax(-1, keepdim=True)
    lost = log_joint < largest + math.log(torch.finfo(log_joint.dtype).eps) - 3
    return torch.logsumexp(log_joint.masked_fill(lost, -torch.inf), -1)
