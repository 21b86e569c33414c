"""One control step and its Jacobians in one call, for models without Jacobians in closed form.

The batch is the last dimension: the compiled kernel sees columns of one length, so that one graph
serves any number of agents, and what it computes in between stays in the cache.
"""

import functools
import logging
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.prediction.trajectron.jacobians import (
    Linearisation,
    has_closed_form,
    linearise,
    linearised_columns,
)
from dmmv_conventions.progress import waiting

LOGGER = logging.getLogger(__name__)
COLUMNS = 512
"""Number of columns that the compiled kernel sees."""
ROWS = 256
"""Rows whose second derivatives are computed at once, at all times; bounds the memory."""


def linearised_rollout(
    dynamics: DynamicsModel,
    state: Float[Tensor, "*b n"],
    controls: Float[Tensor, "*b T m"],
    twice: bool = False,
) -> tuple[Float[Tensor, "*b T1 n"], Linearisation]:
    """States x_0 .. x_T and Jacobians at all times, each step by a compiled kernel.

    With `twice` the second derivatives of a backward pass are one, too, where no parameter of the
    model is learned.

    Can be differentiated once; a second derivative is refused.
    """
    shape, n = controls.shape[:-2], state.shape[-1]
    start = state.expand(*shape, n).flatten(0, -2).mT
    acting = controls.flatten(0, -3).permute(1, 2, 0)
    learned = [each for each in dynamics.parameters() if each.requires_grad]
    columns, jacobians = _LinearisedRollout.apply(dynamics, twice, start, acting, *learned)  # type: ignore[no-untyped-call]
    states = columns.movedim(-1, 0).unflatten(0, shape)
    whole = jacobians.permute(3, 0, 2, 1).unflatten(0, shape)
    return states, Linearisation(whole[..., :n], whole[..., n:])


class _LinearisedRollout(torch.autograd.Function):
    """`linearised_rollout` with the batch last, and with its adjoint.

    With the gradient G in the Jacobians J = (A, B) the recursion is λ_t = g_t + ∂(G · J)/∂x_t +
    A_tᵀ λ_{t+1}: the second derivatives of all times are one call.
    """

    @staticmethod
    def forward(
        ctx: Any,
        dynamics: DynamicsModel,
        twice: bool,
        start: Float[Tensor, "n N"],
        controls: Float[Tensor, "T m N"],
        *learned: Tensor,
    ) -> tuple[Float[Tensor, "T1 n N"], Float[Tensor, "T k n N"]]:
        states, jacobians = [start], []
        for control in controls:
            following, jacobian = _by_kernel(KERNEL, dynamics, states[-1], control)
            states.append(following)
            jacobians.append(jacobian)
        found = torch.stack(states), torch.stack(jacobians)
        ctx.dynamics, ctx.twice = dynamics, twice
        ctx.save_for_backward(controls, *found, *learned)
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor, of_jacobians: Tensor) -> tuple[Tensor | None, ...]:
        controls, states, jacobians, *learned = ctx.saved_tensors
        n, before = states.shape[1], states[:-1]
        pulled_back = _pulled_by_kernel if ctx.twice and not learned else _pulled
        of_state, of_control, *bent = pulled_back(
            ctx.dynamics, before, controls, of_jacobians, learned
        )
        slope, slopes = grad[-1], []
        for step in range(len(controls) - 1, -1, -1):
            slopes.append(slope)
            pulled = (jacobians[step] * slope).sum(1)
            slope = grad[step] + of_state[step] + pulled[:n]
            of_control[step] += pulled[n:]
        if not learned:
            return None, None, slope, of_control
        with torch.enable_grad():
            after = ctx.dynamics(before.mT, controls.mT).mT
        moved = torch.autograd.grad(
            after, learned, torch.stack(slopes[::-1]), materialize_grads=True, allow_unused=True
        )
        totals = [first + second for first, second in zip(bent, moved, strict=True)]
        return None, None, slope, of_control, *totals


def _by_kernel(
    kernel: "Compiled", dynamics: DynamicsModel, *fields: Float[Tensor, "... N"]
) -> tuple[Tensor, ...]:
    """Results for any number of columns by a kernel, which sees a fixed number."""
    count = fields[0].shape[-1]
    missing = -count % COLUMNS
    filled = [
        torch.cat([field, field[..., -1:].expand(*field.shape[:-1], missing)], -1)
        for field in fields
    ]
    split = zip(*(field.split(COLUMNS, -1) for field in filled), strict=True)
    parts = [kernel(dynamics, *(field.contiguous() for field in part)) for part in split]
    return tuple(torch.cat(part, -1)[..., :count] for part in zip(*parts, strict=True))


def bent_columns(
    dynamics: DynamicsModel,
    state: Float[Tensor, "n N"],
    control: Float[Tensor, "m N"],
    toward: Float[Tensor, "k n N"],
) -> tuple[Float[Tensor, "n N"], Float[Tensor, "m N"]]:
    """Gradient of Σ G · J in states and controls, with the Jacobian J of a step and weights G."""

    def along(state: Tensor, control: Tensor) -> Tensor:
        return (linearised_columns(dynamics, state, control)[1] * toward).sum()

    found: tuple[Tensor, Tensor] = torch.func.grad(along, (0, 1))(state, control)
    return found


def _pulled(
    dynamics: DynamicsModel,
    states: Float[Tensor, "T n N"],
    controls: Float[Tensor, "T m N"],
    of_jacobians: Float[Tensor, "T k n N"],
    learned: Sequence[Tensor],
) -> list[Tensor]:
    """Gradient through the Jacobians in states, controls and parameters, some rows at a time."""
    parts = zip(*(part.split(ROWS, -1) for part in (states, controls, of_jacobians)), strict=True)
    found = []
    for state, control, toward in parts:
        points = [part.movedim(1, 0).flatten(1).requires_grad_() for part in (state, control)]
        with torch.enable_grad():
            jacobian = linearised_columns(dynamics, *points)[1]
        weights = toward.permute(1, 2, 0, 3).flatten(2)
        slopes = torch.autograd.grad(
            jacobian, [*points, *learned], weights, materialize_grads=True, allow_unused=True
        )
        unflattened = (slope.unflatten(1, (len(state), -1)).movedim(1, 0) for slope in slopes[:2])
        found.append([*unflattened, *slopes[2:]])
    gathered = list(zip(*found, strict=True))
    joined = [torch.cat(each, -1) for each in gathered[:2]]
    return [*joined, *(functools.reduce(torch.add, each) for each in gathered[2:])]


def _pulled_by_kernel(
    dynamics: DynamicsModel,
    states: Float[Tensor, "T n N"],
    controls: Float[Tensor, "T m N"],
    of_jacobians: Float[Tensor, "T k n N"],
    learned: Sequence[Tensor],
) -> list[Tensor]:
    """The same without parameters, by a kernel."""
    shape = states.shape[0], states.shape[-1]
    fields = (part.movedim(0, -2).flatten(-2) for part in (states, controls, of_jacobians))
    bent = _by_kernel(BENT_KERNEL, dynamics, *fields)
    return [part.unflatten(-1, shape).movedim(-2, 0) for part in bent]


def linearise_compiled(
    dynamics: DynamicsModel, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
) -> Linearisation:
    """`linearise`; a roll-out that asks for it is computed by compiled steps where that gains."""
    return linearise(dynamics, state, control)


def linearise_compiled_twice(
    dynamics: DynamicsModel, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
) -> Linearisation:
    """`linearise_compiled`, the second derivatives of the backward pass compiled as well."""
    return linearise(dynamics, state, control)


def gains_from_compiling(dynamics: DynamicsModel, state: Float[Tensor, "*b n"]) -> bool:
    """Whether `linearised_rollout` applies: no Jacobians in closed form, and a CPU."""
    plain = has_closed_form(dynamics) or state.device.type != "cpu"
    return dynamics.moves_with_pose and not plain


class Compiled:
    """A function that runs compiled, or eagerly after the compiler failed.

    Args:
        function: What to compile, for one shape of its arguments.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.run: Callable[..., Any] | None = None

    def __call__(self, dynamics: DynamicsModel, *tensors: Tensor) -> tuple[Tensor, ...]:
        """Run it for columns of a fixed number; its results are constants."""
        # imported here: the compiler takes twice as long to import as torch
        from torch._dynamo.exc import TorchDynamoException
        from torch._inductor.exc import InductorError

        first = self.run is None
        if self.run is None:
            options: dict[str, Any] = {"loop_ordering_after_fusion": False}
            if tensors[0].device.type == "cpu":
                options["cpp_wrapper"] = True
            LOGGER.info("Compiling the decoder of the predictor: %s", self.function.__name__)
            self.run = torch.compile(self.function, fullgraph=True, dynamic=False, options=options)
        try:
            wait = waiting("compile the decoder of the predictor") if first else nullcontext()
            with wait, torch.no_grad():
                plain = (tensor.detach() for tensor in tensors)
                found: tuple[Tensor, ...] = self.run(dynamics, *plain)
                return found
        except (TorchDynamoException, InductorError) as failure:
            reason = next(iter(str(failure).strip().splitlines()), type(failure).__name__)
            LOGGER.warning(
                "`%s` could not be compiled (%s) and runs eagerly. "
                "Install a C++ compiler, or set `compile=False`.",
                self.function.__name__,
                reason,
            )
            self.run = self.function
            return self.function(dynamics, *tensors)


KERNEL = Compiled(linearised_columns)
BENT_KERNEL = Compiled(bent_columns)
