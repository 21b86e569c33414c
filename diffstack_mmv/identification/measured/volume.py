"""How the uncertainty of what is eliminated depends on the shared unknowns.

The most probable value of all unknowns together is not that of the shared ones alone: where the
errors of the controls are better determined, their share of the evidence is smaller. In a cost that
is linear in them this share is constant. Here it is not, since the lean moves the antenna by its
height times a curvature that is itself unknown: without this slope the height was off by up to
four deviations in rides of a known vehicle.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.identification.measured.elimination import (
    Eliminated,
    Linearisation,
    RideEquations,
)

NEAR = 0.1
"""Step of a difference, in posterior deviations."""


def volumes(equations: RideEquations, parts: Eliminated) -> Float[Tensor, " r"]:
    """Half the logarithm of the determinants of each recording and of its windows."""
    windows = 0.5 * torch.logdet(parts.hessian)
    return (0.5 * torch.logdet(parts.corner)).index_add(0, equations.windows.recording, windows)


def evidence(equations: RideEquations, at: Linearisation) -> float:
    """Logarithm of the evidence of shared unknowns of shape (s,), beyond a constant."""
    volume = volumes(equations, equations.eliminated(at)).sum()
    return float(equations.tilted(at.point) - at.cost.total - volume)


class TiltChange(NamedTuple):
    """What a tilt lacks."""

    tilt: Float[Tensor, "r s"]
    gain: float  # of the logarithm of the evidence, were the volume linear


def tilt_change(equations: RideEquations, at: Linearisation) -> TiltChange:
    """By how much the tilt of a fit, of shape (r, s), differs from the slopes at its end."""
    change = volume_slopes(equations, at) - equations.tilt
    push = change.sum(0)
    return TiltChange(change, 0.5 * float(push @ _covariance(equations.eliminated(at)) @ push))


def volume_slopes(equations: RideEquations, at: Linearisation) -> Float[Tensor, "r s"]:
    """Derivatives of the volumes by the shared unknowns in prior deviations, all else following.

    By one-sided differences, towards the inside of a parameter's range. What follows takes what is
    left of its Newton step as well, with and without the change of a shared unknown: beside a step
    as small as these, it would be taken for their doing.

    Args:
        equations: Of the fit.
        at: Its end.
    """
    parts = equations.eliminated(at)
    size = NEAR * _covariance(parts).diagonal().sqrt()
    inside = equations.shared.bounds(at.point.shared).upper > size
    steps = torch.where(inside, size, -size)

    def volumes_after(step: Float[Tensor, " s"]) -> Float[Tensor, " r"]:
        moved = equations.linearised(equations.followed(at.point, parts, step))
        return volumes(equations, equations.eliminated(moved))

    here = volumes_after(torch.zeros_like(steps))
    slopes = [(volumes_after(step) - here) / step.sum() for step in torch.diag(steps)]
    return torch.stack(slopes, -1)


def _covariance(parts: Eliminated) -> Float[Tensor, "s s"]:
    """Of the shared unknowns, in prior deviations."""
    information = parts.reduced.information.sum(0)
    return torch.linalg.inv(information + torch.eye(len(information), dtype=information.dtype))
