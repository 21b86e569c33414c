"""States from controls."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require, require_tensor


def rollout(
    dynamics: Callable[[Tensor, Tensor], Tensor],
    state: Float[Tensor, "*b n"],
    controls: Float[Tensor, "*b T m"],
) -> Float[Tensor, "*b T1 n"]:
    """Apply x_{t+1} = f(x_t, u_t) for t = 0 .. T-1.

    Args:
        dynamics: One control step, e.g. a `DynamicsModel`.
        state: Initial state x_0.
        controls: u_0 .. u_{T-1}, any T from 0 on.

    Returns:
        The T + 1 states x_0 .. x_T.

    Raises:
        ValueError: The controls have no dimension of time, or other leading dimensions.
        TypeError: State or controls are no tensor.
    """
    require_tensor("state", state)
    require_tensor("controls", controls)
    fits = controls.dim() == state.dim() + 1 and controls.shape[:-2] == state.shape[:-1]
    leading = ", ".join([*map(str, state.shape[:-1]), "T", "m"])
    found = f"shape {tuple(controls.shape)}"
    require(fits, "controls", f"have the shape ({leading}) to fit the state", found)
    states = [state]
    for control in controls.unbind(-2):
        states.append(dynamics(states[-1], control))
    return torch.stack(states, -2)
