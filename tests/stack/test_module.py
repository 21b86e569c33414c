"""The stack: losses, scores and gradients of whole batches."""

import pytest
import torch
from torch._inductor.exc import InductorError

from diffstack_mmv.control import ILQR
from diffstack_mmv.costs import (
    ControlEffort,
    ExpectedCollision,
    FinalGoal,
    ReferenceTracking,
    WeightedCost,
)
from diffstack_mmv.dynamics import DiffKBM
from diffstack_mmv.metrics import OF_THE_PREDICTION, OPEN_LOOP
from diffstack_mmv.planning import (
    CandidateFan,
    FutureGoal,
    MPCPlanner,
    PredictedGoal,
    generated_moments,
)
from diffstack_mmv.prediction import ConstantVelocity, PathToGoal, PredictedPath, StandStill
from diffstack_mmv.prediction.goal_baselines import hermite_spline
from diffstack_mmv.stack import DiffStackMMV, LossWeights
from diffstack_mmv.types import Mode, Motion, StackBatch, Tracks, map_tensors
from diffstack_mmv.vehicles import load_vehicle
from dmmv_conventions.progress import shown_by
from tests.heard import Heard

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


def batch_of(count=3, neighbors=2, steps=STEPS):
    """Egos that ride straight ahead at 3 to 5 m/s, with agents standing to their left."""
    velocity = torch.stack([torch.linspace(3, 5, count), torch.zeros(count)], -1)
    origin = torch.zeros(count, 2)
    beside = torch.tensor([2.0, 3.0]).expand(count, neighbors, 2)
    still = torch.zeros(count, neighbors, 2)
    future = straight_tracks(origin, velocity, steps, 0)
    return StackBatch(
        straight_tracks(origin, velocity, 11, 11),
        future,
        straight_tracks(beside, still, 11, 11),
        straight_tracks(beside, still, steps, 0),
        future.motion.position[:, -1],
        0.1,
    )


def without_future(batch, sample, first_row):
    """The batch, with no recording of one ego from a row of its future on; something stands there.

    Its neighbors have no future at all.
    """
    valid, position = batch.ego_future.valid.clone(), batch.ego_future.motion.position.clone()
    valid[sample, first_row:], position[sample, first_row:] = False, 50.0
    motion = batch.ego_future.motion._replace(position=position)
    seen = batch.neighbors_future.valid.clone()
    seen[sample] = False
    return batch._replace(
        ego_future=batch.ego_future._replace(motion=motion, valid=valid),
        neighbors_future=batch.neighbors_future._replace(valid=seen),
        goal=position[:, -1],
    )


def stack_of(goal, predictor=None, loss=None, steps=STEPS):
    spec = load_vehicle("bicycle")
    terms = {
        "goal": FinalGoal(),
        "tracking": ReferenceTracking(),
        "effort": ControlEffort(),
        "collision": ExpectedCollision(),
    }
    cost = WeightedCost(terms, {"goal": 1.0, "tracking": 0.5, "effort": 0.1, "collision": 0.5})
    planner = MPCPlanner(DiffKBM(spec), cost, ILQR(), CandidateFan(), steps)
    made = predictor or ConstantVelocity(steps, 0.1)
    return DiffStackMMV(made, planner, goal, loss or LossWeights(), torch.optim.Adam)


@pytest.mark.parametrize("goal", [FutureGoal(), PredictedGoal()], ids=lambda goal: goal.name)
def test_straight_riding_is_predicted_and_planned_to_the_centimetre(goal):
    stack = stack_of(goal)
    scores = stack.sample_scores(batch_of())
    assert set(scores) == set(OPEN_LOOP)
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
    stack, logged = stack_of(FutureGoal(), loss=LossWeights(1.0, 0.0, 0.0, 0.0)), {}
    stack.planner.forward = lambda problem: pytest.fail("planned")
    stack.log_dict = lambda *args, **kwargs: None
    stack.log = lambda name, value: logged.update({name: float(value)})
    assert torch.isfinite(stack.training_step(batch_of(), 0))
    stack.validation_step(batch_of(), 0)
    stack.on_validation_epoch_end()
    assert {f"val/{name}" for name in OF_THE_PREDICTION} <= set(logged)
    assert logged["val/ade"] < 0.01
    assert not any("plan" in name for name in logged)


def test_a_loss_that_reaches_nothing_that_is_learned_is_refused():
    alone = LossWeights(planning=0.0, control=0.0)
    with pytest.raises(ValueError, match="`loss` must reach something that is learned, but got a"):
        stack_of(PredictedGoal(), loss=alone).configure_optimizers()
    planned = stack_of(PredictedGoal())
    planned.require_learnable()
    with pytest.raises(ValueError, match="but got no parameter at all. Give another predictor"):
        planned.requires_grad_(False).require_learnable()


def test_scores_of_the_prediction_need_no_plan():
    plain, whole = (stack_of(PredictedGoal(), loss=LossWeights(1.0, w, w, w)) for w in (0.0, 1.0))
    for stack in (plain, whole):
        stack.validation_step(batch_of(), 0)
    scores = whole.scores.compute()
    assert plain.scores.compute() == {name: scores[name] for name in plain.scores.compute()}


def test_training_goes_on_where_nothing_can_be_compiled(monkeypatch, caplog):
    def refusing(function, **options):
        def call(*arguments):
            raise InductorError(RuntimeError("no compiler"), None)

        return call

    monkeypatch.setattr(torch, "compile", refusing)
    stack = stack_of(PredictedGoal(), StandStill(STEPS, 0.1))
    stack.log_dict = lambda *args, **kwargs: None
    expected = stack.training_step(batch_of(), 0)
    stack.planner.solver = ILQR(compile=True)
    with caplog.at_level("INFO"), shown_by(heard := Heard()):
        loss = stack.training_step(batch_of(), 0)
        loss.backward()
    assert "compile the solver for DiffKBM: attempt" in heard.titles
    assert loss.item() == pytest.approx(expected.item(), rel=1e-5)
    assert stack.planner.cost.log_weight.grad.abs().max() > 0
    assert "Compiling the solver for DiffKBM" in caplog.text
    assert "runs eagerly" in caplog.text


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


OF_THE_END = {"fde", "median_fde", "mean_fde", "combined_fde", "plan_fde", "miss_rate"}
NOT_PREDICTED = set(OPEN_LOOP) - set(OF_THE_PREDICTION)
WITHOUT_TRUTH = {"collision_rate", "solved"}


@pytest.mark.parametrize(
    ("goal", "first_row", "missing"),
    [
        (PredictedGoal(), 0, set(OPEN_LOOP) - WITHOUT_TRUTH),
        (PredictedGoal(), STEPS - 1, OF_THE_END),
        # the goal of the plan was not recorded: no score of the plan means anything
        (FutureGoal(), 0, set(OPEN_LOOP)),
        (FutureGoal(), STEPS - 1, NOT_PREDICTED | OF_THE_END),
    ],
    ids=["predicted-none", "predicted-no end", "future-none", "future-no end"],
)
def test_scores_that_cannot_be_judged_are_nan_and_the_others_stay(goal, first_row, missing):
    stack, batch = stack_of(goal), batch_of()
    whole = stack.sample_scores(batch)
    scores = stack.sample_scores(without_future(batch, 1, first_row))
    assert {name for name, value in scores.items() if torch.isnan(value[1])} == missing
    for name, value in scores.items():
        assert torch.allclose(value[[0, 2]], whole[name][[0, 2]], atol=1e-5)


@pytest.mark.parametrize("goal", [FutureGoal(), PredictedGoal()], ids=lambda goal: goal.name)
def test_a_sample_without_future_adds_nothing_to_the_training_loss(goal):
    stack, batch = stack_of(goal, StandStill(STEPS, 0.1)), batch_of()
    stack.log_dict = lambda *args, **kwargs: None
    kept = map_tensors(lambda field: field[[0, 2]], batch)
    losses, gradients = [], []
    for given in (kept, without_future(batch, 1, 0)):
        stack.zero_grad()
        losses.append(stack.training_step(given, 0))
        losses[-1].backward()
        gradients.append(stack.planner.cost.log_weight.grad.clone())
    assert losses[1].item() == pytest.approx(losses[0].item(), rel=1e-4)
    assert torch.allclose(gradients[1], gradients[0], rtol=1e-3, atol=1e-5)
    assert gradients[0].abs().max() > 0


def test_what_stands_in_rows_that_are_not_valid_counts_for_nothing():
    stack, batch = stack_of(PredictedGoal(), StandStill(STEPS, 0.1)), batch_of()
    stack.log_dict = lambda *args, **kwargs: None

    def spoilt(tracks, filling):
        valid = tracks.valid.clone()
        valid[1:, ..., STEPS // 2 :] = False

        def filled(field):
            at = valid.reshape(valid.shape + (1,) * (field.dim() - valid.dim()))
            return torch.where(at, field, filling)

        return tracks._replace(motion=map_tensors(filled, tracks.motion), valid=valid)

    losses, gradients = [], []
    for filling in (0.0, torch.nan):
        given = batch._replace(
            ego_future=spoilt(batch.ego_future, filling),
            neighbors_future=spoilt(batch.neighbors_future, filling),
        )
        stack.zero_grad()
        losses.append(stack.training_step(given, 0))
        losses[-1].backward()
        gradients.append(stack.planner.cost.log_weight.grad.clone())
    assert losses[1].item() == losses[0].item()
    assert torch.equal(gradients[1], gradients[0])
    assert gradients[0].abs().max() > 0


def test_a_batch_without_any_future_has_a_finite_loss_and_no_gradient():
    stack, batch = stack_of(PredictedGoal()), batch_of(count=1)
    stack.log_dict = lambda *args, **kwargs: None
    loss = stack.training_step(without_future(batch, 0, 0), 0)
    loss.backward()
    assert loss.item() == 0.0
    assert all((p.grad == 0).all() for p in stack.parameters() if p.grad is not None)


def test_a_loss_does_not_hide_that_the_predictor_diverged():
    stack, batch = stack_of(PredictedGoal(), loss=LossWeights(1.0, 0.0, 0.0, 0.0)), batch_of()
    stack.log_dict = lambda *args, **kwargs: None
    stack.predictor.loss = lambda batch: torch.tensor([1.0, torch.nan, torch.nan])
    assert torch.isnan(stack.training_step(batch, 0))
    assert torch.isnan(stack.training_step(without_future(batch, 1, 0), 0))
    stack.predictor.loss = lambda batch: torch.tensor([1.0, torch.nan, 2.0])
    assert stack.training_step(without_future(batch, 1, 0), 0).item() == 1.5


def test_validation_counts_what_it_could_not_judge():
    stack, logged = stack_of(PredictedGoal()), {}
    stack.log = lambda name, value: logged.update({name: float(value)})
    stack.validation_step(without_future(batch_of(), 1, 0), 0)
    stack.on_validation_epoch_end()
    assert logged["val/n_missing"] == logged["val/bicycle/n_missing"] == 1
    assert logged["val/ade"] < 0.01


def test_kernels_are_those_of_planner_and_predictor(monkeypatch):
    stack, calls = stack_of(PredictedGoal()), []
    monkeypatch.setattr(stack.planner, "compile_solver", lambda: calls.append("planner"))
    monkeypatch.setattr(stack.predictor, "compile_kernels", calls.append)
    stack.compile_kernels()
    assert calls == ["planner", generated_moments]
