"""Roll-outs of models in generated libraries, for those who know nothing of solvers."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.planning.candidates import Arc, ArcStep, eager_arc_step


def generated_moments(
    dynamics: DynamicsModel,
    start: Float[Tensor, "N n"],
    covariance: Float[Tensor, "N n n"],
    controls: Float[Tensor, "N T m"],
    scale: Float[Tensor, "N T m m"],
) -> tuple[Float[Tensor, "N T 2"], Float[Tensor, "N T 2 2"]] | None:
    """Mean and covariance of positions under Gaussian controls, None where there is no library.

    On a CPU with a C++ compiler; a library is built at the first use of a model, which takes
    seconds (DiffGM3: 20), and kept on disk.

    Args:
        dynamics: The model.
        start: Mean of the first state.
        covariance: Of the first state.
        controls: Mean controls.
        scale: Cholesky factors of their covariances.
    """
    # imported here: a stack that runs eagerly does without
    from diffstack_mmv.control.native.moments import moments

    return moments(dynamics, start, covariance, controls, scale)


class _ArcModule(nn.Module):
    """One step on an arc, from (state, anything) to (next state, control)."""

    def __init__(self, dynamics: DynamicsModel) -> None:
        super().__init__()
        self.dynamics = dynamics

    def forward(self, row: Float[Tensor, "*b k"], arc: Float[Tensor, "*b 2"]) -> Tensor:
        state = row[..., : self.dynamics.state_dim]
        control = self.dynamics.control_for(state, *arc.unbind(-1))
        return torch.cat([self.dynamics(state, control), control], -1)


def generated_arc_step(dynamics: DynamicsModel) -> ArcStep:
    """Steps on arcs in a call of a generated library, eagerly where there is none."""
    # imported here: a stack that runs eagerly does without
    from diffstack_mmv.control.native.steps import generated_step

    eager, n, m = eager_arc_step(dynamics), dynamics.state_dim, dynamics.control_dim
    bound = dynamics.bounds.lower
    if bound.device.type != "cpu":
        return eager
    step = generated_step(dynamics, _ArcModule(dynamics), n + m, len(Arc._fields), bound.dtype)
    if step is None:
        return eager

    def arc_step(state: Tensor, arc: Arc) -> tuple[Tensor, Tensor]:
        shape = state.shape[:-1]
        row = torch.cat([state, state.new_zeros(*shape, m)], -1).flatten(0, -2)
        wanted = torch.stack([each.expand(shape) for each in arc], -1).flatten(0, -2)
        following, control = step(row, wanted).unflatten(0, shape).split([n, m], -1)
        return following, control

    return arc_step
