"""The stack: losses, scores and gradients of whole batches."""

import pandas as pd
import pytest
import torch

from diffstack_mmv.control import ILQR
from diffstack_mmv.costs import (
    ControlEffort,
    ExpectedCollision,
    FinalGoal,
    ReferenceTracking,
    WeightedCost,
)
from diffstack_mmv.dynamics import DiffKBM
from diffstack_mmv.planning import CandidateFan, FutureGoal, MPCPlanner, PredictedGoal
from diffstack_mmv.prediction import ConstantVelocity, StandStill
from diffstack_mmv.prediction.goal_baselines import hermite_spline
from diffstack_mmv.stack import (
    SCORES,
    DiffStackMMV,
    LossWeights,
    PathToGoal,
    PredictedPath,
    representative,
)
from diffstack_mmv.types import Mode, Motion, StackBatch, Tracks, map_tensors
from diffstack_mmv.vehicles import load_vehicle

STEPS = 8


def straight_tracks(start, velocity, rows, first):
    """Agents `*b` that keep their velocity; row `first` is the present."""
    time = 0.1 * (torch.arange(rows) + 1 - first)
    position = start.unsqueeze(-2) + velocity.unsqueeze(-2) * time.unsqueeze(-1)
    heading = (
        torch.atan2(velocity[..., 1], velocity[..., 0]).unsqueeze(-1).expand(position.shape[:-1])
    )
    forward = velocity.norm(dim=-1, keepdim=True).expand(position.shape[:-1])
    body = torch.stack([forward, torch.zeros_like(forward)], -1)
    motion = Motion(position, heading, body, torch.zeros_like(heading))
    mode = torch.full(start.shape[:-1], int(Mode.BICYCLE))
    extent = torch.tensor([1.8, 0.6]).expand(*start.shape[:-1], 2)
    return Tracks(motion, extent, mode, torch.ones(position.shape[:-1], dtype=torch.bool))


def batch_of(count=3, neighbors=2):
    """Egos that ride straight ahead at 3 to 5 m/s, with agents standing to their left."""
    velocity = torch.stack([torch.linspace(3, 5, count), torch.zeros(count)], -1)
    origin = torch.zeros(count, 2)
    beside = torch.tensor([2.0, 3.0]).expand(count, neighbors, 2)
    still = torch.zeros(count, neighbors, 2)
    future = straight_tracks(origin, velocity, STEPS, 0)
    return StackBatch(
        straight_tracks(origin, velocity, 11, 11),
        future,
        straight_tracks(beside, still, 11, 11),
        straight_tracks(beside, still, STEPS, 0),
        future.motion.position[:, -1],
        0.1,
    )


def stack_of(goal, predictor=None, loss=None):
    spec = load_vehicle("bicycle")
    terms = {
        "goal": FinalGoal(),
        "tracking": ReferenceTracking(),
        "effort": ControlEffort(),
        "collision": ExpectedCollision(),
    }
    cost = WeightedCost(terms, {"goal": 1.0, "tracking": 0.5, "effort": 0.1, "collision": 0.5})
    planner = MPCPlanner(DiffKBM(spec), cost, ILQR(), CandidateFan(), STEPS)
    made = predictor or ConstantVelocity(STEPS, 0.1)
    return DiffStackMMV(made, planner, goal, loss or LossWeights(), torch.optim.Adam)


@pytest.mark.parametrize("goal", [FutureGoal(), PredictedGoal()], ids=lambda goal: goal.name)
def test_straight_riding_is_predicted_and_planned_to_the_centimetre(goal):
    stack = stack_of(goal)
    scores = stack.sample_scores(batch_of())
    assert set(scores) == set(SCORES)
    assert scores["ade"].max() < 0.01
    assert scores["plan_ade"].max() < 0.05
    assert (scores["solved"] == 1).all()
    assert (scores["collision_rate"] == 0).all()


@pytest.mark.parametrize("neighbors", [0, 1, 3])
def test_any_number_of_neighbors_scores_finitely(neighbors):
    scores = stack_of(PredictedGoal()).sample_scores(batch_of(neighbors=neighbors))
    assert all(torch.isfinite(value).all() for value in scores.values())


def test_future_goal_reads_the_recording_and_predicted_goal_does_not():
    stack = stack_of(FutureGoal(), StandStill(STEPS, 0.1))
    batch = batch_of()
    assert torch.equal(stack(batch).goal, batch.goal)
    stack.goal = PredictedGoal()
    assert torch.allclose(stack(batch).goal, torch.zeros(3, 2), atol=1e-5)


def test_planning_losses_reach_cost_weights_and_wheelbase():
    stack = stack_of(PredictedGoal(), StandStill(STEPS, 0.1))
    batch = batch_of()
    losses = stack.planning_losses(batch, stack(batch))
    (losses["planning_ce"] + losses["control"]).mean().backward()
    assert stack.planner.cost.log_weight.grad.abs().max() > 0
    assert all(torch.isfinite(p.grad).all() for p in stack.parameters() if p.grad is not None)


def test_hindsight_cost_does_not_reward_new_weights():
    stack = stack_of(FutureGoal())
    batch = batch_of()
    output = stack(batch)
    frozen = map_tensors(torch.Tensor.detach, output.plan)
    cost = stack.planner.hindsight_cost(frozen, output.problem)
    assert not torch.stack(list(cost.values())).requires_grad


def test_nothing_is_planned_where_planning_weighs_nothing():
    stack = stack_of(FutureGoal(), loss=LossWeights(1.0, 0.0, 0.0, 0.0))
    stack.planner.forward = lambda problem: pytest.fail("planned")
    stack.log_dict = lambda *args, **kwargs: None
    assert torch.isfinite(stack.training_step(batch_of(), 0))


@pytest.mark.parametrize(
    ("baseline", "error"),
    [
        (PredictedPath(StandStill(STEPS, 0.1)), None),
        (PredictedPath(ConstantVelocity(STEPS, 0.1)), 0.0),
        (PathToGoal(hermite_spline), 0.0),
    ],
)
def test_baselines_answer_with_paths(baseline, error):
    batch = batch_of()
    path = baseline(batch, batch.goal)
    distance = (path - batch.ego_future.motion.position).norm(dim=-1)
    assert path.shape == (3, STEPS, 2)
    assert distance.max() < 0.01 if error is not None else distance.max() > 2.0


def test_representative_samples_are_in_motion_where_there_are_such():
    frame = pd.DataFrame(
        {
            "mode": ["bicycle"] * 4 + ["scooter"],
            "moving": [False, True, True, True, False],
            "plan_ade": [0.0, 3.0, 1.0, 2.0, 0.5],
        }
    )
    chosen = representative(frame)
    assert chosen["bicycle"] == {"best": 2, "median": 3, "worst": 1}
    assert set(chosen["scooter"].values()) == {4}
