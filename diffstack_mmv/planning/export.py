"""The optimiser of a planner as a library for robots without Python."""

from pathlib import Path

import torch
from torch import Tensor

from diffstack_mmv.checks import message, require, require_at_least
from diffstack_mmv.control import ILQR, Batched
from diffstack_mmv.control.native.export import Export, Exported
from diffstack_mmv.planning.coordinates import PhysicalControls
from diffstack_mmv.planning.objective import NAMES, batched_objective
from diffstack_mmv.planning.planner import MPCPlanner
from diffstack_mmv.planning.problem import (
    build_problem,
    initial_state,
    predicted_obstacles,
    straight_reference,
)
from diffstack_mmv.types import Discs, Ego, Forecast, HeadingOf, Motion, PlanningProblem
from dmmv_conventions.libraries import require_machine

AWAY_M = 1e3
"""Where agents are by default that are not there."""


@torch.no_grad()
def export_planner(
    planner: MPCPlanner,
    folder: Path,
    agents: int = 5,
    components: int = 1,
    discs: int = 1,
    machine: str = "native",
) -> Exported:
    """Write the optimiser of a planner: libplanner.so, planner.h and planner.cpp.

    The goal, the reference, the discs of the vehicle and the forecast of the agents are parameters
    of the library, as are the weights of the cost and the numbers of the vehicle, whose values at
    the time of the export are the defaults.

    Args:
        planner: Its dynamics, cost and solver; proposals and choice stay behind.
        folder: Where the files go.
        agents: Most agents at a time; those that are not there are not valid.
        components: Components of the forecast of each.
        discs: Discs that the outline of the vehicle is made of.
        machine: Processor as the C++ compiler calls it; "native" is this one.

    Returns:
        The files, and the entries of the parameters.

    Raises:
        ValueError: A number is not positive, the planner has constraints, its solver more step
            sizes than a library tries, or the compiler does not build for the processor.
        TypeError: The solver is no `ILQR`.
        CannotLowerError: Dynamics or cost have an operation that has no scalar form.
        CannotBuildError: There is no C++ compiler.
    """
    for name, value in (("agents", agents), ("components", components), ("discs", discs)):
        require_at_least(name, value, 1)
    if machine != "native":
        require_machine(machine)
    solver = planner.solver
    if not isinstance(solver, ILQR):
        raise TypeError(message("planner.solver", "be an ILQR", type(solver).__name__))
    limits = {} if planner.constraints is None else planner.constraints.limits
    remedy = "Export the planner without them: their optimiser has no library."
    require(not limits, "planner.constraints", "be none", list(limits), "", remedy)
    dynamics = planner.dynamics
    problem = _example(planner, agents, components, discs)
    # what the library takes and returns are controls in SI units, whatever the planner optimises in
    cost = batched_objective(planner, dynamics, problem, PhysicalControls(dynamics))
    cost = Batched(cost.function, *(each.contiguous() for each in cost.tensors))
    named: dict[str, Tensor] = dict(zip(NAMES, cost.tensors, strict=True))
    learned = {name: tensor for name, tensor in planner.named_parameters()}
    fixed = {name: tensor for name, tensor in planner.named_buffers()}
    state = initial_state(dynamics, problem.ego)
    controls = state.new_zeros(1, planner.steps, dynamics.control_dim)
    write = Export(solver, machine)
    names = named | learned | fixed
    return write(Batched(dynamics), cost, names, dynamics.bounds, state, controls, folder)


def _example(planner: MPCPlanner, agents: int, components: int, discs: int) -> PlanningProblem:
    """A problem of the right shape: at rest, ten metres before the goal, with nobody around."""
    like = planner.dynamics.bounds.lower
    zero, steps = like.new_zeros(1), planner.steps
    motion = Motion(like.new_zeros(1, 2), zero, like.new_zeros(1, 2), zero)
    goal = like.new_tensor([[10.0, 0.0]])
    outline = Discs(like.new_zeros(1, discs), like.new_full((1, discs), 0.3))
    futures = like.new_full((1, agents, components, steps, 2), AWAY_M)
    spread = torch.eye(2).to(like).expand(*futures.shape, 2)
    weight = like.new_full((1, agents, components), 1 / components).log()
    people = (
        futures[:, :, 0, 0],
        like.new_full((1, agents), 0.3),
        like.new_zeros(1, agents, dtype=torch.bool),
    )
    return build_problem(
        Ego(motion, HeadingOf.BODY, outline),
        goal,
        straight_reference(motion, goal, steps, 2.0),
        predicted_obstacles(*people, Forecast(weight, futures, spread)),
    )
