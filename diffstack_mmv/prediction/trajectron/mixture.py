"""From Gaussian controls to Gaussian positions by linearisation of the dynamics."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.dynamics import DynamicsModel, rollout
from diffstack_mmv.geometry import direction
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
    columns = _jacobian(
        lambda point: dynamics(point[..., :n], point[..., n:]), torch.cat([state, control], -1)
    )
    return Linearisation(columns[..., :n], columns[..., n:])


def linearise_shared(
    dynamics: DynamicsModel,
    state: Float[Tensor, "R K T n"],
    control: Float[Tensor, "R K T m"],
) -> Linearisation:
    """Jacobians at the mean over the K components, turned to the heading of each component.

    A model that does not care where it stands and where it points has, with the frame S = (rotation
    of the position by θ, else identity), A(θ) = S A(0) Sᵀ and B(θ) = S B(0). What is neglected is
    how speed and control differ between the components; what is gained is a factor K.
    """
    fields = dynamics.State._fields
    pose = torch.tensor([name in ("position_x", "position_y", "heading") for name in fields])
    centre = torch.where(pose.to(state.device), torch.zeros_like(state), state).mean(1)
    shared = linearise(dynamics, centre, control.mean(1))
    if "heading" not in fields:
        return Linearisation(
            shared.state.unsqueeze(1).expand(*state.shape, -1),
            shared.control.unsqueeze(1).expand(*state.shape, -1),
        )
    frame = _frames(state[..., fields.index("heading")], state.shape[-1])
    turned = frame @ shared.state.unsqueeze(1)
    return Linearisation(turned @ frame.mT, frame @ shared.control.unsqueeze(1))


def _frames(heading: Float[Tensor, "*b"], size: int) -> Float[Tensor, "*b n n"]:
    """Rotate the first two of so many columns by a heading in rad, and keep the others."""
    forward = direction(heading)
    left = torch.stack([-forward[..., 1], forward[..., 0]], -1)
    rotation = nn.functional.pad(torch.stack([forward, left], -1), (0, size - 2, 0, size - 2))
    rest = torch.ones(size, dtype=heading.dtype, device=heading.device)
    rest[:2] = 0
    return rotation + torch.diag(rest)


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
    return _jacobian(state_at, point)


def _jacobian(
    function: Callable[[Tensor], Tensor], point: Float[Tensor, "*b p"]
) -> Float[Tensor, "*b o p"]:
    """Derivatives of a function of single points, one tangent per column."""

    def push(tangent: Float[Tensor, " p"]) -> Tensor:
        return torch.func.jvp(function, (point,), (tangent.expand_as(point),))[1]

    tangents = torch.eye(point.shape[-1], dtype=point.dtype, device=point.device)
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
    jacobians: Callable[[DynamicsModel, Tensor, Tensor], Linearisation] = linearise,
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
        jacobians: `linearise` at every point, or `linearise_shared` where that is too slow.
    """
    state = dynamics.state_on_course(motion)
    states = rollout(dynamics, state, controls)
    linearisation = jacobians(dynamics, states[..., :-1, :], controls)
    start_factor = start_sensitivity(dynamics, motion) * start_deviation.unsqueeze(-2)
    covariance = propagate(linearisation, start_factor, control_scale)
    return PositionMoments(states[..., 1:, :2], covariance[..., :2, :2])
