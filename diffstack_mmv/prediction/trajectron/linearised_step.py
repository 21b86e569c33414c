"""One control step and its Jacobians in one call, for models without Jacobians in closed form.

The batch is the last dimension: a compiled kernel sees columns of one length, so that one graph
serves any number of agents, and what it computes in between stays in the cache.
"""

import functools
import logging
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

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

LOGGER = logging.getLogger(__name__)
COLUMNS = 512
"""Length of the columns of a compiled kernel."""


class LinearStep(NamedTuple):
    """A step, and its derivatives: entry (j, i) is that of output i in the state or control j."""

    state: Float[Tensor, "n N"]
    jacobian: Float[Tensor, "k n N"]


def linearised_rollout(
    dynamics: DynamicsModel, state: Float[Tensor, "*b n"], controls: Float[Tensor, "*b T m"]
) -> tuple[Float[Tensor, "*b T1 n"], Linearisation]:
    """States x_0 .. x_T and Jacobians at all times, each step by a compiled kernel.

    The roll-out needs no adjoint of its own: autograd goes back through the steps, and each is
    computed again there.
    """
    shape = controls.shape[:-2]
    columns = [state.expand(*shape, -1).flatten(0, -2).mT]
    jacobians = []
    for control in controls.flatten(0, -3).permute(1, 2, 0):
        step = linearised_step(dynamics, columns[-1], control, *_KERNELS)
        columns.append(step.state)
        jacobians.append(step.jacobian)
    states = torch.stack(columns).movedim(-1, 0).unflatten(0, shape)
    whole = torch.stack(jacobians).permute(3, 0, 2, 1).unflatten(0, shape)
    n = state.shape[-1]
    return states, Linearisation(whole[..., :n], whole[..., n:])


def linearise_compiled(
    dynamics: DynamicsModel, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
) -> Linearisation:
    """`linearise`; a roll-out that asks for it is computed by compiled steps where that gains."""
    return linearise(dynamics, state, control)


def gains_from_compiling(dynamics: DynamicsModel, state: Float[Tensor, "*b n"]) -> bool:
    """Whether `linearised_rollout` applies: no Jacobians in closed form, and a CPU."""
    plain = has_closed_form(dynamics) or state.device.type != "cpu"
    return dynamics.moves_with_pose and not plain


def linearised_step(
    dynamics: DynamicsModel,
    state: Float[Tensor, "n N"],
    control: Float[Tensor, "m N"],
    linearised: Callable[..., tuple[Tensor, Tensor]] | None = None,
    pulled: Callable[..., tuple[Tensor, ...]] | None = None,
) -> LinearStep:
    """x⁺ = f(x, u) with ∂f/∂(x, u), differentiable once in state, control and parameters.

    Nothing but the arguments is kept for the backward pass. Columns of the pose need no tangent:
    a model that does not care where it stands and where it points moves with its pose.

    Args:
        dynamics: A model with a pose among its states.
        state: Columns of states.
        control: Columns of controls.
        linearised: Kernel for columns of a fixed number, `linearised_columns` by default.
        pulled: Kernel for the gradient, `pulled_columns` by default.
    """
    named = {name: each for name, each in dynamics.named_parameters() if each.requires_grad}
    kernels = linearised or linearised_columns, pulled or pulled_columns
    given = (dynamics, tuple(named), *kernels, state, control, *named.values())
    return LinearStep(*_Step.apply(*given))  # type: ignore[no-untyped-call]


class _Step(torch.autograd.Function):
    """`linearised_step` with its gradient."""

    @staticmethod
    def forward(
        ctx: Any,
        dynamics: DynamicsModel,
        names: tuple[str, ...],
        linearised: Callable[..., tuple[Tensor, Tensor]],
        pulled: Callable[..., tuple[Tensor, ...]],
        *tensors: Tensor,
    ) -> tuple[Tensor, Tensor]:
        ctx.dynamics, ctx.names, ctx.pulled = dynamics, names, pulled
        ctx.save_for_backward(*tensors)
        state, control, *parameters = tensors
        parts = [
            linearised(dynamics, names, *columns, *parameters)
            for columns in _cut((state, control), isinstance(linearised, Compiled))
        ]
        following, jacobian = (_joined(part, state.shape[-1]) for part in zip(*parts, strict=True))
        return following, jacobian

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        state, control, *parameters = ctx.saved_tensors
        pulled = [
            ctx.pulled(ctx.dynamics, ctx.names, *columns, *parameters)
            for columns in _cut((state, control, *grads), isinstance(ctx.pulled, Compiled))
        ]
        of_state, of_control, *rest = zip(*pulled, strict=True)
        count = state.shape[-1]
        slopes = [functools.reduce(torch.add, part) for part in rest]
        nothing = (None,) * 4
        return *nothing, _joined(of_state, count), _joined(of_control, count), *slopes


def _cut(fields: Sequence[Tensor], fixed: bool) -> list[tuple[Tensor, ...]]:
    """Parts of fixed length, the last one filled up with copies that carry no gradient.

    The last column is repeated in states and controls, the first two fields; the others, which are
    gradients, go on with zeros.
    """
    count = fields[0].shape[-1]
    if not fixed:
        return [tuple(fields)]
    missing = -count % COLUMNS
    if missing:
        copies = [field[..., -1:].expand(*field.shape[:-1], missing) for field in fields]
        filled = [*copies[:2], *(torch.zeros_like(copy) for copy in copies[2:])]
        fields = [torch.cat(pair, -1) for pair in zip(fields, filled, strict=True)]
    split = (field.split(COLUMNS, -1) for field in fields)
    return [tuple(part.contiguous() for part in parts) for parts in zip(*split, strict=True)]


def _joined(parts: Sequence[Tensor], count: int) -> Tensor:
    return parts[0][..., :count] if len(parts) == 1 else torch.cat(list(parts), -1)[..., :count]


def pulled_columns(
    dynamics: DynamicsModel, names: tuple[str, ...], *tensors: Tensor
) -> tuple[Tensor, ...]:
    """Gradient through `linearised_columns` in columns and values.

    Args:
        dynamics: The model.
        names: Names of the parameters.
        tensors: Columns of states, of controls, of the gradients in both results; the values.
    """
    state, control, of_state, of_jacobian, *values = tensors

    def function(*inputs: Tensor) -> tuple[Tensor, Tensor]:
        return linearised_columns(dynamics, names, *inputs)

    pull = torch.func.vjp(function, state, control, *values)[1]
    found: tuple[Tensor, ...] = pull((of_state, of_jacobian))
    return found


class Compiled:
    """A function that runs compiled, or eagerly after the compiler failed.

    Args:
        function: What to compile, for one shape of its arguments.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.run: Callable[..., Any] | None = None

    def __call__(
        self, dynamics: DynamicsModel, names: tuple[str, ...], *tensors: Tensor
    ) -> tuple[Tensor, ...]:
        """Run it for columns of a fixed number."""
        # imported here: the compiler takes twice as long to import as torch
        from torch._dynamo.exc import TorchDynamoException
        from torch._inductor.exc import InductorError

        if self.run is None:
            options: dict[str, Any] = {"loop_ordering_after_fusion": False}
            if tensors[0].device.type == "cpu":
                options["cpp_wrapper"] = True
            LOGGER.info("Compiling the decoder of the predictor: %s", self.function.__name__)
            self.run = torch.compile(self.function, fullgraph=True, dynamic=False, options=options)
        try:
            with torch.no_grad():
                plain = (tensor.detach() for tensor in tensors)
                found: tuple[Tensor, ...] = self.run(dynamics, names, *plain)
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
            return self.function(dynamics, names, *tensors)


_KERNELS = Compiled(linearised_columns), Compiled(pulled_columns)
