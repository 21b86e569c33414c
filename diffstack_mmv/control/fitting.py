"""Whether the callables of a problem fit its tensors, asked once per code and shape."""

from collections.abc import Callable, Hashable

import torch
from jaxtyping import Float
from torch import Tensor
from torch._functorch import pyfunctorch

from diffstack_mmv.checks import message, require, require_callable, require_tensor
from diffstack_mmv.control.expansion import pad_controls
from diffstack_mmv.control.optimizer import Cost, Dynamics
from diffstack_mmv.control.selection import Batched, kind
from diffstack_mmv.types import Bounds, on_host

MOVED = 0.3
"""By which part of its size a state is moved to see whether costs at other times follow."""
ROUNDED = 100.0
"""Multiple of the rounding of a cost by which it then may change."""
_known: set[tuple[Hashable, ...]] = set()


def require_tensors(bounds: object, state: object, controls: object) -> None:
    """Refuse arguments of other types than the solver takes, and a `torch.func` transform of it.

    Raises:
        TypeError: State, controls or a bound is no tensor, or the bounds are no `Bounds`.
        ValueError: A transform, such as `vmap`, is at work.
    """
    transforms = [each.key().name for each in pyfunctorch.retrieve_all_functorch_interpreters()]
    remedy = "Give a batch instead of vmap, and take derivatives by autograd."
    told = ", ".join(transforms)
    require(not transforms, "ILQR", "be called outside of torch.func", told, "", remedy)
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
    """Refuse a model or a cost whose result the solver cannot work with.

    A wrong shape would be broadcast, and the answer would be that of another problem; the cost of a
    time that depends on another time has a Hessian that the solver does not see, and its gradient
    would be wrong; what is cut off from autograd looks like a constant, whose minimum is the guess.
    Both are called for every code and every shape of the arguments, not for every solve.

    Args:
        dynamics: One step of all problems.
        cost: Cost of each time.
        state: Initial state.
        controls: Guess of the controls.

    Raises:
        ValueError: A result has the wrong shape or precision or no gradient, the cost of a time
            depends on another one, one of them writes into its arguments, `vmap` cannot call it,
            or a tensor that `Batched` names has not one entry per problem.
        TypeError: One of them cannot be called, or a result or such a tensor is no tensor.
    """
    require_callable("dynamics", dynamics, "It gives the next state: (state, control) -> state.")
    require_callable("cost", cost, "It gives one cost per time: (states, controls) -> cost.")
    for name, function in (("dynamics", dynamics), ("cost", cost)):
        _require_entries(name, function, state.shape[:-1])
    key = (kind(dynamics), kind(cost), state.shape, controls.shape, state.dtype)
    if key in _known or controls.numel() == 0:
        return
    after = untouched("dynamics", dynamics, state, controls[..., 0, :])
    require_tensor("dynamics(state, control)", after)
    found, wanted = tuple(after.shape), tuple(state.shape)
    require(found == wanted, "dynamics", f"return the shape {wanted} of the state", found)
    _require_precision("dynamics", after, state)
    states = state.unsqueeze(-2).repeat_interleave(controls.shape[-2] + 1, -2)
    padded = pad_controls(controls)
    value = untouched("cost", cost, states, padded)
    require_tensor("cost(states, controls)", value)
    found, wanted = tuple(value.shape), tuple(states.shape[:-1])
    remedy = "Sum over the columns of states and controls only: one cost per problem and time."
    require(found == wanted, "cost", f"return the shape {wanted}", found, "", remedy)
    _require_gradient("dynamics", dynamics, state, controls[..., 0, :])
    _require_batchable("dynamics", dynamics, state, controls[..., 0, :])
    _require_stagewise("cost", cost, states, padded, value)
    _known.add(key)


@torch.no_grad()
def require_fitting_constraint(
    name: str,
    constraint: Callable[[Tensor, Tensor], Tensor],
    states: Float[Tensor, "*b T1 n"],
    controls: Float[Tensor, "*b T1 m"],
    value: Float[Tensor, "*b T1 k"],
) -> None:
    """Refuse a constraint whose result the solver cannot work with, for the reasons of a cost.

    Args:
        name: What to call it.
        constraint: Gives the values of all times.
        states: Where it was asked.
        controls: The same, with a row for the end.
        value: What it returned there, of the shape that it has to be.

    Raises:
        ValueError: The value has the wrong precision or no gradient, that of a time depends on
            another one, `vmap` cannot call the constraint, or a tensor that `Batched` names has not
            one entry per problem.
    """
    _require_entries(name, constraint, states.shape[:-2])
    key = (kind(constraint), states.shape, controls.shape, states.dtype)
    if key in _known or value.numel() == 0:
        return
    _require_stagewise(name, constraint, states, controls, value)
    _known.add(key)


def _require_entries(name: str, function: object, batch: torch.Size) -> None:
    """Refuse named tensors that are not of each problem: those of some problems would be others'.

    Asked in every solve, since the tensors are those of a solve; it takes no time.
    """
    if not isinstance(function, Batched) or len(batch) != 1:
        return
    remedy = "Let the function hold what all problems share, and expand what one entry stands for."
    for tensor in function.tensors:
        require_tensor(f"{name}.tensors", tensor)
        wanted, found = f"have one entry for each of {batch[0]} problems", tuple(tensor.shape)
        fits = tensor.shape[:1] == batch
        require(fits, f"{name}.tensors", wanted, f"shape {found}", "", remedy)


def untouched(name: str, function: Callable[..., Tensor], *arguments: Tensor) -> Tensor:
    """The result for copies, of any shape; a function that writes into them is refused.

    Raises:
        ValueError: It does.
    """
    copies = [each.clone() for each in arguments]
    result = function(*copies)
    # what inference mode makes counts no writes
    same = all(each.is_inference() or each._version == 0 for each in copies)
    remedy = "Join new columns by torch.stack, or write into a clone()."
    require(same, name, "leave its arguments as they are", "one that writes into them", "", remedy)
    return result


def _require_stagewise(
    name: str,
    function: Callable[[Tensor, Tensor], Tensor],
    states: Float[Tensor, "*b T1 n"],
    controls: Float[Tensor, "*b T1 m"],
    value: Tensor,
) -> None:
    """Refuse a function along a trajectory that is not one of each time, in its precision."""
    _require_precision(name, value, states)
    _require_gradient(name, function, states, controls)
    _require_batchable(name, function, states, controls)
    if on_host(value):  # another device would be waited for
        _require_separable(name, function, states, controls, value)


def _require_precision(name: str, result: Tensor, state: Tensor) -> None:
    remedy = "Convert it: model.to(state.dtype)."
    found, wanted = result.dtype, state.dtype
    require(found == wanted, name, f"return {wanted} as the state", found, "", remedy)


def _require_gradient(name: str, function: Callable[..., Tensor], *arguments: Tensor) -> None:
    """Refuse a function that autograd cannot follow to any of its arguments."""
    if torch.is_inference_mode_enabled():  # where autograd follows nothing
        return
    leaves = [each.detach().requires_grad_() for each in arguments]
    with torch.enable_grad():
        total = function(*leaves).sum()
    known = total.requires_grad
    found = torch.autograd.grad(total, leaves, allow_unused=True) if known else ()
    require(
        any(each is not None for each in found),
        name,
        "be differentiable in state or control",
        "a result without a gradient",
        remedy="Use operations of torch, without detach(), item() and no_grad().",
    )


def _require_batchable(name: str, function: Callable[..., Tensor], *arguments: Tensor) -> None:
    """Refuse a function that `vmap` cannot call for many times or step sizes at once."""
    try:
        # a bare module would be printed by vmap
        torch.vmap(lambda *each: function(*each))(*(each.unsqueeze(0) for each in arguments))
    except RuntimeError as unable:
        if type(unable) is not RuntimeError:  # such as one for want of memory
            raise
        told = str(unable).removeprefix("vmap: ").partition(". ")[0]
        remedy = (
            "Write torch.where instead of `if` on tensors or a mask as index, no item(), and "
            "torch.stack instead of writing into a tensor."
        )
        needs, found = "be one that torch.vmap can call", f"'{told}'"
        raise ValueError(message(name, needs, found, "", remedy)) from unable


def _require_separable(
    name: str,
    function: Callable[[Tensor, Tensor], Tensor],
    states: Float[Tensor, "*b T1 n"],
    controls: Float[Tensor, "*b T1 m"],
    value: Tensor,
) -> None:
    """Refuse a function whose entries of one time change with states or controls of another."""
    time = states.dim() - 2
    late = torch.arange(states.shape[time]) >= states.shape[time] // 2
    # what is not finite tells nothing, and sums may be rounded otherwise
    size = value.abs().amax(time, keepdim=True).nan_to_num(torch.inf, torch.inf)
    allowed = ROUNDED * torch.finfo(value.dtype).eps * (1 + size)
    for half in (late, ~late):
        others = half.to(value).unsqueeze(-1)
        moved = (part + others * MOVED * (1 + part.abs()) for part in (states, controls))
        follows = (function(*moved) - value).abs() > allowed
        require(
            not bool(follows.movedim(time, 0)[~half].any()),
            name,
            "depend at each time on state and control of that time alone",
            "one that changes with those of other times",
            remedy="Make what it compares, such as the control before, a part of the state.",
        )
