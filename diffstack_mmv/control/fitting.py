"""Whether the callables of a problem fit its tensors, asked once per code and shape."""

from types import CodeType

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import message, require, require_tensor
from diffstack_mmv.control.optimizer import Cost, Dynamics
from diffstack_mmv.types import Bounds

Key = tuple[CodeType | type, CodeType | type, torch.Size, torch.Size]
_known: set[Key] = set()


def require_tensors(bounds: object, state: object, controls: object) -> None:
    """Refuse arguments of other types than the solver takes.

    Raises:
        TypeError: State, controls or a bound is no tensor, or the bounds are no `Bounds`.
    """
    if not isinstance(bounds, Bounds):
        remedy = "Write Bounds(lower, upper)."
        raise TypeError(message("bounds", "be Bounds", type(bounds).__name__, "", remedy))
    require_tensor("state", state)
    require_tensor("controls", controls)
    for name, bound in bounds._asdict().items():
        require_tensor(f"bounds.{name}", bound)


@torch.no_grad()
def require_fitting(
    dynamics: Dynamics, cost: Cost, state: Float[Tensor, "*b n"], controls: Float[Tensor, "*b T m"]
) -> None:
    """Refuse a model or a cost whose result has another shape than the solver works with.

    A wrong shape would be broadcast, and the answer would be that of another problem. Both are
    called once for every code and every shape of the arguments, not for every solve.

    Args:
        dynamics: One step of all problems.
        cost: Cost of each time.
        state: Initial state.
        controls: Guess of the controls.

    Raises:
        ValueError: A result has the wrong shape.
        TypeError: A result is no tensor.
    """
    key = (_code(dynamics), _code(cost), state.shape, controls.shape)
    if key in _known or controls.numel() == 0:
        return
    after = dynamics(state, controls[..., 0, :])
    require_tensor("dynamics(state, control)", after)
    found, wanted = tuple(after.shape), tuple(state.shape)
    require(found == wanted, "dynamics", f"return the shape {wanted} of the state", found)
    states = state.unsqueeze(-2).repeat_interleave(controls.shape[-2] + 1, -2)
    padded = torch.cat([controls, torch.zeros_like(controls[..., :1, :])], -2)
    value = cost(states, padded)
    require_tensor("cost(states, controls)", value)
    found, wanted = tuple(value.shape), tuple(states.shape[:-1])
    remedy = "Sum over the columns of states and controls only: one cost per problem and time."
    require(found == wanted, "cost", f"return the shape {wanted}", found, "", remedy)
    _known.add(key)


def _code(function: Dynamics | Cost) -> CodeType | type:
    return getattr(function, "__code__", type(function))
