"""From Gaussian controls to Gaussian positions by linearisation of the dynamics."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics import DynamicsModel, rollout
from diffstack_mmv.types import Motion


class Linearisation(NamedTuple):
    """Jacobians of one control step at points `*b`."""

    state: Float[Tensor, "*b n n"]
    control: Float[Tensor, "*b n m"]


def linearise(
    dynamics: DynamicsModel, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
) -> Linearisation:
    """Jacobians A = ∂f/∂x and B = ∂f/∂u at all points in one call, by forward mode."""
    n = state.shape[-1]
    tangents = torch.eye(n + control.shape[-1], dtype=state.dtype, device=state.device)
    shape = (len(tangents), *(1,) * (state.dim() - 1), -1)
    columns = _pushed(
        lambda point: dynamics(point[..., :n], point[..., n:]),
        torch.cat([state, control], -1),
        tangents.reshape(shape),
    )
    return Linearisation(columns[..., :n], columns[..., n:])


def start_sensitivity(dynamics: DynamicsModel, motion: Motion) -> Float[Tensor, "*b n 4"]:
    """Jacobian of the initial state in position x, y (m), heading (rad) and speed (m/s)."""

    def state_at(point: Float[Tensor, "*b 4"]) -> Float[Tensor, "*b n"]:
        velocity = torch.stack(
            [point[..., 3], motion.velocity[..., 1].expand_as(point[..., 3])], -1
        )
        return dynamics.state_on_course(
            Motion(
                point[..., :2], point[..., 2], velocity, motion.yaw_rate.expand_as(point[..., 2])
            )
        )

    point = torch.cat([motion.position, motion.heading.unsqueeze(-1), motion.velocity[..., :1]], -1)
    tangents = torch.eye(4, dtype=point.dtype, device=point.device)
    return _pushed(state_at, point, tangents.reshape(4, *(1,) * (point.dim() - 1), 4))


def _pushed(
    function: Callable[[Tensor], Tensor],
    point: Float[Tensor, "*b p"],
    tangents: Float[Tensor, "t *b p"],
) -> Float[Tensor, "*b o t"]:
    """Directional derivatives along the tangents, stacked as columns."""

    def push(tangent: Tensor) -> Tensor:
        return torch.func.jvp(function, (point,), (tangent.expand_as(point),))[1]

    return torch.func.vmap(push, out_dims=-1)(tangents)


def propagate(
    linearisation: Linearisation,
    start_factor: Float[Tensor, "*b n s"],
    control_scale: Float[Tensor, "*b T m m"],
) -> Float[Tensor, "*b T n n"]:
    """Covariances Σ⁺ = A Σ Aᵀ + B L (B L)ᵀ of the states x_1 .. x_T.

    Args:
        linearisation: A and B at the times 0 .. T-1, in the dimension T.
        start_factor: Any factor F of the covariance F Fᵀ of x_0.
        control_scale: Cholesky factors L of the control's covariance.
    """
    covariance = start_factor @ start_factor.mT
    driven = linearisation.control @ control_scale
    noise = driven @ driven.mT
    covariances = []
    for jacobian, added in zip(linearisation.state.unbind(-3), noise.unbind(-3), strict=True):
        covariance = jacobian @ covariance @ jacobian.mT + added
        covariances.append(covariance)
    return torch.stack(covariances, -3)


class PositionMoments(NamedTuple):
    """Mean and covariance of positions over time."""

    mean: Float[Tensor, "*b T 2"]  # m
    covariance: Float[Tensor, "*b T 2 2"]  # m²


def integrate(
    dynamics: DynamicsModel,
    motion: Motion,
    controls: Float[Tensor, "*b T m"],
    control_scale: Float[Tensor, "*b T m m"],
    start_deviation: Float[Tensor, "*b 4"],
) -> PositionMoments:
    """Integrate Gaussian controls through the dynamics of an agent.

    The mean is rolled out exactly; the covariance follows to first order along it. The output is
    the model's reference point, as far as `motion` reads it linearly from the state's first two
    columns.

    Args:
        dynamics: Dynamics of the agents.
        motion: Present motion of the agents, `*b`, at heading 0 of their own frame.
        controls: Mean controls.
        control_scale: Cholesky factors of their covariances.
        start_deviation: Standard deviations of the present position along and across in m, heading
            in rad, speed in m/s.
    """
    state = dynamics.state_on_course(motion)
    states = rollout(dynamics, state, controls)
    linearisation = linearise(dynamics, states[..., :-1, :], controls)
    start_factor = start_sensitivity(dynamics, motion) * start_deviation.unsqueeze(-2)
    covariance = propagate(linearisation, start_factor, control_scale)
    return PositionMoments(states[..., 1:, :2], covariance[..., :2, :2])
