"""This package's solver, eager and compiled."""

import numpy as np
import torch

from diffstack_mmv.control import ILQR, Batched, Bounds
from peers import driving


class Space:
    """Functions of torch under the names of numpy."""

    cos, sin, tan, exp = torch.cos, torch.sin, torch.tan, torch.exp
    maximum = staticmethod(torch.clamp_min)


def callables(parameters, wheelbase):
    """Dynamics and cost with one row of parameters per problem; the wheelbase is shared."""

    def dynamics(state, control):
        return torch.stack(driving.step(Space, state.unbind(-1), control.unbind(-1), wheelbase), -1)

    def cost(states, controls, parameters):
        p = parameters.unsqueeze(-2).unbind(-1)
        running = driving.stage_cost(Space, states.unbind(-1), controls.unbind(-1), p)
        final = driving.final_cost(states.unbind(-1), p)
        return torch.cat([running[..., :-1], final[..., -1:]], -1)

    return Batched(dynamics), Batched(cost, parameters)


def solver(states, parameters, steps, compile):
    """A function that solves the problems, differentiable in parameters and wheelbase."""
    box = Bounds(torch.tensor(driving.LOWER), torch.tensor(driving.UPPER))
    state, p = (torch.tensor(part, dtype=torch.float32) for part in (states, parameters))
    p.requires_grad_()
    wheelbase = torch.tensor(driving.WHEELBASE, requires_grad=True)
    ilqr = ILQR(compile=compile, tolerance=1e-4)
    controls = torch.zeros(len(state), steps, 2)

    def solve():
        return ilqr(*callables(p, wheelbase), box, state, controls)

    return solve


def controls_of(solution):
    """Controls as float64 numbers."""
    return solution.controls.detach().double().numpy().astype(np.float64)
