"""This package's solver, eager and compiled."""

import numpy as np
import torch

from diffstack_mmv.control import ILQR, Batched, Bounds
from peers import driving
from peers.in_torch import Space

ONE_BY_ONE = 4096  # all of a batch in a generated library, as the planner has it


def callables(parameters, physical, problem=driving.OBSTACLE):
    """Dynamics and cost with one row of parameters per problem; the physical number is shared."""

    def dynamics(state, control):
        return torch.stack(problem.step(Space, state.unbind(-1), control.unbind(-1), physical), -1)

    def cost(states, controls, parameters):
        p = parameters.unsqueeze(-2).unbind(-1)
        running = problem.stage_cost(Space, states.unbind(-1), controls.unbind(-1), p)
        final = problem.final_cost(Space, states.unbind(-1), p)
        return torch.cat([running[..., :-1], final[..., -1:]], -1)

    return Batched(dynamics), Batched(cost, parameters)


def leaves_of(parameters, dtype=torch.float32, problem=driving.OBSTACLE):
    """What the solution is differentiated by: parameters of the costs and a number of the dynamics."""
    p = torch.tensor(parameters, dtype=dtype, requires_grad=True)
    return p, torch.tensor(problem.physical, dtype=dtype, requires_grad=True)


def solver(
    states, leaves, steps, compile, problem=driving.OBSTACLE, tolerance=1e-4, one_by_one=ONE_BY_ONE
):
    """A function that solves the problems, differentiable in the leaves and in their precision."""
    box = Bounds(*(leaves[0].detach().new_tensor(side) for side in (problem.lower, problem.upper)))
    state = torch.tensor(states, dtype=leaves[0].dtype)
    ilqr = ILQR(compile=compile, tolerance=tolerance, one_by_one=one_by_one)
    controls = state.new_zeros(len(state), steps, 2)

    def solve():
        return ilqr(*callables(*leaves, problem), box, state, controls)

    return solve


def controls_of(solution):
    """Controls as float64 numbers."""
    return solution.controls.detach().double().numpy().astype(np.float64)
