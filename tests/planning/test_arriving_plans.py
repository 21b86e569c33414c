"""Plans that end at their goal converge in single precision too."""

from copy import deepcopy

import pytest
import torch

from diffstack_mmv.control import ILQR
from diffstack_mmv.dynamics import DiffKBM
from diffstack_mmv.planning import AccelerationShares
from diffstack_mmv.types import Discs, Ego, HeadingOf, Motion, Obstacles, PlanningProblem
from diffstack_mmv.vehicles import load_vehicle
from tests.contracts.test_cost_contract import build


def alone(goal):
    """Problems of a vehicle that meets nobody."""
    batch = len(goal)
    nothing = torch.zeros(batch, 2)
    now = Motion(nothing, nothing[:, 0], nothing, nothing[:, 0])
    ego = Ego(now, HeadingOf.BODY, Discs(nothing[:, :1], nothing[:, :1]))
    nobody = Obstacles(
        torch.zeros(batch, 0, 1, 13, 2),
        torch.zeros(batch, 0, 1),
        torch.zeros(batch, 0),
        torch.zeros(batch, 0, dtype=torch.bool),
    )
    reference = torch.zeros(batch, 13, 2)
    return PlanningProblem(ego, goal, reference, torch.full((batch,), 3.0), nobody)


@pytest.mark.parametrize("precision", [torch.float32, torch.float64])
@pytest.mark.parametrize("name", ["closed_loop", "unlimited"])
def test_a_plan_that_ends_at_its_goal_converges(name, precision):
    # the way that a vehicle at 3 m/s has to stop at the goal, and less and more of it
    torch.manual_seed(0)
    model = DiffKBM(load_vehicle("bicycle"), dt_s=0.25).to(precision)
    cost = deepcopy(build(name)).to(precision)
    goal = torch.rand(64, 2, dtype=precision) * torch.tensor([4.0, 0.5]) + torch.tensor([2.5, 0.0])
    shares, problem = AccelerationShares(model), alone(goal)

    def objective(states, coordinates):
        controls = shares.padded_controls(states, coordinates)
        return cost(model.motion(states, controls), controls, problem)

    start = torch.tensor([0.0, 0.0, 0.0, 3.0], dtype=precision).expand(64, 4)
    guess = torch.full((64, 12, 2), 0.5, dtype=precision) * torch.tensor([1.0, 0.0])
    solver = ILQR(max_iterations=60, tolerance=1e-4)
    solution = solver(shares.step, objective, shares.bounds, start, guess.to(precision))
    ends = (solution.states[:, -1, :2] - goal).norm(dim=-1)
    assert (ends < 0.05).float().mean() > 0.5
    assert solution.converged.all()
