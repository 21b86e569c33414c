"""From Gaussian controls to Gaussian positions by linearisation of the dynamics."""

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.prediction.base import GaussianRollout
from diffstack_mmv.prediction.trajectron.adjoint import rolled_out, time_outermost
from diffstack_mmv.prediction.trajectron.jacobians import Linearisation, jacobian, linearise
from diffstack_mmv.types import Motion


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
    return jacobian(state_at, point)


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
    leading = start_factor.shape[:-2]
    moved, pushed, scale = (_problems_last(field) for field in (*linearisation, control_scale))
    factor = _problems_last(start_factor.unsqueeze(-3))[0]
    covariances: Tensor = _Propagation.apply(moved, pushed, scale, _product(factor, factor))  # type: ignore[no-untyped-call]
    return covariances.movedim(-1, 0).unflatten(0, leading)


class _Propagation(torch.autograd.Function):
    """`propagate` with the problems last, and with its adjoint: autograd would keep all products.

    With the gradient P in Σ⁺, symmetric, and D = B L, the gradients are 2 P A Σ in A, Aᵀ P A in Σ,
    and 2 P D in D.
    """

    @staticmethod
    def forward(
        ctx: Any,
        matrices: Float[Tensor, "T n n N"],
        pushes: Float[Tensor, "T n m N"],
        scales: Float[Tensor, "T m m N"],
        covariance: Float[Tensor, "n n N"],
    ) -> Float[Tensor, "T n n N"]:
        before, after = covariance, []
        for matrix, push, scale in zip(matrices, pushes, scales, strict=True):
            driven = _product(push, scale.transpose(0, 1))
            moved = _product(_product(matrix, before), matrix)
            before = moved + _product(driven, driven)
            after.append(before)
        covariances = torch.stack(after)
        ctx.save_for_backward(matrices, pushes, scales, covariance, covariances)
        return covariances

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Float[Tensor, "T n n N"]) -> tuple[Tensor, ...]:
        matrices, pushes, scales, first, covariances = ctx.saved_tensors
        grad = 0.5 * (grad + grad.transpose(1, 2))
        slope = torch.zeros_like(first)
        slopes = []
        for step in range(len(matrices) - 1, -1, -1):
            matrix, push, scale = matrices[step], pushes[step], scales[step]
            slope = slope + grad[step]
            before = covariances[step - 1] if step > 0 else first
            turned = _product(slope, matrix.transpose(0, 1))
            of_driven = 2 * _product(slope, _product(scale.transpose(0, 1), push))
            of_matrix = 2 * _product(turned, before)
            of_scale = _product(push.transpose(0, 1), of_driven.transpose(0, 1))
            slopes.append((of_matrix, _product(of_driven, scale), of_scale))
            slope = _product(matrix.transpose(0, 1), turned.transpose(0, 1))
        found = (torch.stack(parts[::-1]) for parts in zip(*slopes, strict=True))
        return *found, slope


def _problems_last(field: Float[Tensor, "*b T r c"]) -> Float[Tensor, "T r c N"]:
    """All problems in the last dimension, along which a processor computes several at once."""
    return field.flatten(0, -4).movedim(0, -1) if field.dim() > 3 else field.unsqueeze(-1)


def _product(left: Float[Tensor, "r k N"], right: Float[Tensor, "c k N"]) -> Float[Tensor, "r c N"]:
    """Products A Bᵀ of small matrices; faster by far than a library call per matrix."""
    pairs = zip(left.unbind(1), right.unbind(1), strict=True)
    row, column = next(pairs)
    result = row.unsqueeze(1) * column
    for row, column in pairs:
        result = torch.addcmul(result, row.unsqueeze(1), column)
    return result


def _covariance(
    sensitivity: Float[Tensor, "*#b n s"], deviation: Float[Tensor, "*b s"]
) -> Float[Tensor, "*b n n"]:
    """Covariance J diag(σ²) Jᵀ; products of J are made once for all that share it."""
    products = sensitivity.unsqueeze(-2) * sensitivity.unsqueeze(-3)
    return (products * deviation.square()[..., None, None, :]).sum(-1)


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
    generated: GaussianRollout | None = None,
) -> PositionMoments:
    """Integrate Gaussian controls through the dynamics of an agent.

    The mean is rolled out exactly; the covariance follows to first order along it. The output is
    the model's reference point, as far as `motion` reads it linearly from the state's first two
    columns.

    Args:
        dynamics: Dynamics of the agents.
        motion: Present motion of the agents, `*b` or what expands to it, nearly at heading 0 of
            their own frame.
        controls: Mean controls.
        control_scale: Cholesky factors of their covariances.
        start_deviation: Standard deviations of the present position along and across in m, heading
            in rad, speed in m/s.
        jacobians: `linearise` at every point, or `linearise_shared` where that is too slow.
        generated: Does all of it in one call where it can, with `linearise`.
    """
    state = dynamics.state_on_course(motion)
    sensitivity, leading = start_sensitivity(dynamics, motion), controls.shape[:-2]
    if generated is not None:
        covariance = _covariance(sensitivity, start_deviation)
        rows = state.expand(*leading, -1), covariance, controls, control_scale
        found = generated(dynamics, *(row.reshape(-1, *row.shape[len(leading) :]) for row in rows))
        if found is not None:
            return PositionMoments(*(moment.unflatten(0, leading) for moment in found))
    state = state.expand(*leading, -1)
    start_factor = sensitivity * start_deviation.unsqueeze(-2)
    controls = time_outermost(controls)
    states = rolled_out(dynamics, state, controls)
    linearisation = jacobians(dynamics, states[..., :-1, :], controls)
    covariance = propagate(linearisation, start_factor, control_scale)
    return PositionMoments(states[..., 1:, :2], covariance[..., :2, :2])
