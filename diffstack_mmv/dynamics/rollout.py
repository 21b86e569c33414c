"""States from controls."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor


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
    """
    states = [state]
    for control in controls.unbind(-2):
        states.append(dynamics(states[-1], control))
    return torch.stack(states, -2)
