"""The rollout of a model, with the adjoint recursion for its gradient."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from diffstack_mmv.dynamics import DynamicsModel, rollout
from diffstack_mmv.prediction.trajectron.jacobians import has_closed_form, linearise


def rolled_out(
    dynamics: DynamicsModel, state: Float[Tensor, "*b n"], controls: Float[Tensor, "*b T m"]
) -> Float[Tensor, "*b T1 n"]:
    """States x_0 .. x_T as from `rollout`; in memory time is the outermost dimension.

    Where the Jacobians A have a closed form, the backward pass is the recursion λ_t = g_t + Aᵀ
    λ_{t+1}, and one product with the derivatives of all steps at once. It can then be
    differentiated once; a second derivative is refused.
    """
    parameters = [each for each in dynamics.parameters() if each.requires_grad]
    learning = any(tensor.requires_grad for tensor in (state, controls, *parameters))
    if torch.is_grad_enabled() and learning and has_closed_form(dynamics):
        states: Tensor = _AdjointRollout.apply(dynamics, state, controls, *parameters)  # type: ignore[no-untyped-call]
        return states
    return time_outermost(rollout(dynamics, state, controls))


def time_outermost(values: Float[Tensor, "*b T c"]) -> Float[Tensor, "*b T c"]:
    """The same values, laid out in memory in the order T, *b, c."""
    return values.movedim(-2, 0).contiguous().movedim(0, -2)


class _AdjointRollout(torch.autograd.Function):
    """`rolled_out` for a model with Jacobians in closed form."""

    @staticmethod
    def forward(
        ctx: Any, dynamics: DynamicsModel, state: Tensor, controls: Tensor, *parameters: Tensor
    ) -> Tensor:
        states = time_outermost(rollout(dynamics, state, controls))
        ctx.dynamics = dynamics
        ctx.save_for_backward(states, controls, *parameters)
        return states

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        states, controls, *parameters = ctx.saved_tensors
        before, controls = states[..., :-1, :], controls.detach().requires_grad_()
        jacobian = linearise(ctx.dynamics, before, controls.detach()).state
        slope = grad[..., -1, :]
        slopes = [slope]
        for step in range(jacobian.shape[-3] - 1, 0, -1):
            slope = grad[..., step, :] + _pulled(jacobian[..., step, :, :], slope)
            slopes.append(slope)
        with torch.enable_grad():
            after = ctx.dynamics(before, controls)
        sources = [controls, *parameters]
        found = torch.autograd.grad(
            after, sources, torch.stack(slopes[::-1], -2), allow_unused=True
        )
        first = grad[..., 0, :] + _pulled(jacobian[..., 0, :, :], slope)
        return None, first, *found


def _pulled(jacobian: Float[Tensor, "*b n n"], slope: Float[Tensor, "*b n"]) -> Tensor:
    """Product Aᵀ λ."""
    return (jacobian * slope.unsqueeze(-1)).sum(-2)
