"""The stack: the one place where prediction, planning and their losses meet."""

from collections.abc import Callable
from typing import Any, NamedTuple

import pytorch_lightning as pl
import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.metrics import MeanByMode, collides
from diffstack_mmv.planning import (
    GoalSource,
    MPCPlanner,
    build_problem,
    closest_candidate,
    cross_entropy,
    disc_radius,
    observed_obstacles,
    predicted_obstacles,
    predicted_reference,
    present,
    tracked_ego,
)
from diffstack_mmv.prediction import Predictor, ego_forecast, neighbors_forecast, strongest
from diffstack_mmv.types import Forecast, Plan, PlanningProblem, StackBatch

LOG_PROB_FLOOR = -20.0  # nats, as in Trajectron++ and DiffStack


class LossWeights(NamedTuple):
    """Weights of the parts of the training loss, dimensionless.

    L = prediction · L_pred + planning · (CE + hindsight · C) + control · L_ctrl
    """

    prediction: float = 1.0
    planning: float = 1.0
    hindsight: float = 0.01
    control: float = 1.0


class StackOutput(NamedTuple):
    """What the stages made of a batch."""

    forecast: Forecast  # B 1+N K T, the ego first
    goal: Float[Tensor, "B 2"]  # m
    problem: PlanningProblem
    plan: Plan


class DiffStackMMV(pl.LightningModule):
    """Prediction, planning and control, trained end to end by imitation.

    Source: Cai et al., DMMV, Sec. III, and Karkus et al., DiffStack (CoRL 2022).

    Args:
        predictor: Forecasts ego and neighbors.
        planner: Plans with the dynamics of the ego.
        goal: Where the goal of a plan comes from.
        loss: Weights of the parts of the loss.
        optimizer: Makes the optimizer from the parameters.
        scheduler: Makes the learning-rate schedule from the optimizer, stepped once per epoch.
        obstacle_components: How many predicted components of each neighbor the plan sees.
    """

    def __init__(
        self,
        predictor: Predictor,
        planner: MPCPlanner,
        goal: GoalSource,
        loss: LossWeights,
        optimizer: Callable[..., torch.optim.Optimizer],
        scheduler: Callable[..., Any] | None = None,
        obstacle_components: int = 5,
    ) -> None:
        super().__init__()
        require_at_least("obstacle_components", obstacle_components, 1)
        self.predictor = predictor
        self.planner = planner
        self.goal = goal
        self.loss_weights = loss
        self.optimizer = optimizer
        self.scheduler = scheduler
        self.obstacle_components = obstacle_components
        self.scores = MeanByMode(SCORES)

    def forward(self, batch: StackBatch) -> StackOutput:
        """Predict all agents, choose the goal, and plan."""
        return self.plan(batch, self.predictor.predict(batch))

    def plan(self, batch: StackBatch, forecast: Forecast) -> StackOutput:
        """Choose the goal and plan, given a forecast of all agents."""
        ego = ego_forecast(forecast)
        goal = self.goal(batch, ego)
        neighbors = present(batch.neighbors_past)
        obstacles = predicted_obstacles(
            neighbors.motion.position,
            disc_radius(neighbors.extent),
            neighbors.valid,
            strongest(neighbors_forecast(forecast), self.obstacle_components),
        )
        motion = present(batch.ego_past).motion
        reference = predicted_reference(motion, ego.most_likely(), goal, batch.dt_s)
        problem = build_problem(tracked_ego(batch.ego_past, goal), goal, reference, obstacles)
        return StackOutput(forecast, goal, problem, self.planner(problem))

    def planning_losses(
        self, batch: StackBatch, output: StackOutput
    ) -> dict[str, Float[Tensor, " B"]]:
        """Losses of each sample: `planning_ce` in nats, `planning_cost` (1), `control` in m².

        The hindsight cost is that of the plan under the true futures of the other agents.
        """
        future = batch.ego_future
        plan = output.plan
        target = closest_candidate(
            plan.candidates.position[..., 1:, :], future.motion.position, future.valid
        )
        hindsight = output.problem._replace(
            obstacles=observed_obstacles(batch.neighbors_past, batch.neighbors_future)
        )
        parts = self.planner.hindsight_cost(plan, hindsight)
        squared = (plan.motion.position[..., 1:, :] - future.motion.position).square().sum(-1)
        return {
            "planning_ce": cross_entropy(plan.logits, target),
            "planning_cost": torch.stack(list(parts.values())).sum(0),
            "control": _time_mean(squared, future.valid),
        }

    def training_step(self, batch: StackBatch, batch_idx: int) -> Tensor:
        """Weighted sum of the losses.

        Nothing is planned where planning and control weigh nothing.
        """
        weights = self.loss_weights
        if weights.planning > 0 or weights.control > 0:
            forecast, judged = self.predictor.predict_and_judge(batch)
            means = self._planning_means(batch, self.plan(batch, forecast))
            planning = means["planning_ce"] + weights.hindsight * means["planning_cost"]
            loss = weights.planning * planning + weights.control * means["control"]
        else:
            judged, means = self.predictor.loss(batch), {}
            loss = judged.new_zeros(())
        means["prediction"] = judged.mean()
        loss = loss + weights.prediction * means["prediction"]
        logged = {f"train/{name}": value.detach() for name, value in means.items()}
        self.log_dict(logged | {"train/loss": loss.detach()}, batch_size=len(batch.goal))
        return loss

    def _planning_means(self, batch: StackBatch, output: StackOutput) -> dict[str, Tensor]:
        """Means of the planning losses.

        A plan without solution only counts in the cross entropy.
        """
        losses = self.planning_losses(batch, output)
        converged = output.plan.converged
        return {
            "planning_ce": losses["planning_ce"].mean(),
            "planning_cost": _masked_mean(losses["planning_cost"], converged),
            "control": _masked_mean(losses["control"], converged),
            "solved": converged.float().mean(),
        }

    def validation_step(self, batch: StackBatch, batch_idx: int) -> None:
        """Add the scores of a batch to the means by mode."""
        self.scores.update(self.sample_scores(batch), batch.ego_past.mode)

    def on_validation_epoch_end(self) -> None:
        """Log the means, reduced over all processes."""
        for name, value in self.scores.compute().items():
            self.log(f"val/{name}", value)
        self.scores.reset()

    def predict_step(self, batch: StackBatch, batch_idx: int) -> dict[str, Tensor]:
        """Scores of each sample."""
        return self.sample_scores(batch)

    def sample_scores(self, batch: StackBatch) -> dict[str, Float[Tensor, " B"]]:
        """Every score of each sample, by the names of `SCORES`."""
        return self.score(batch, self(batch))

    def score(self, batch: StackBatch, output: StackOutput) -> dict[str, Float[Tensor, " B"]]:
        """Scores of what the stages made of a batch, by the names of `SCORES`."""
        future = batch.ego_future
        human = future.motion.position
        ego = ego_forecast(output.forecast)
        planned = output.plan.motion.position
        losses = self.planning_losses(batch, output)
        truth = observed_obstacles(batch.neighbors_past, batch.neighbors_future)
        log_prob = ego.log_prob(human).clamp_min(LOG_PROB_FLOOR)
        ce, cost = losses["planning_ce"], losses["planning_cost"]
        return {
            **displacements("", ego.most_likely(), batch),
            "nll": -_time_mean(log_prob, future.valid),
            **displacements("plan_", planned[..., 1:, :], batch),
            "planning_ce": ce,
            "planning_cost": cost,
            "planning_loss": ce + self.loss_weights.hindsight * cost,
            "collision_rate": collides(planned, output.problem.ego.discs.radius[..., 0], truth).to(
                planned
            ),
            "solved": output.plan.converged.to(planned),
        }

    def configure_optimizers(self) -> Any:
        """Optimizer over all learnable parameters, with its schedule where one is given."""
        optimizer = self.optimizer(params=[p for p in self.parameters() if p.requires_grad])
        if self.scheduler is None:
            return optimizer
        return {"optimizer": optimizer, "lr_scheduler": self.scheduler(optimizer=optimizer)}


SCORES = (
    "ade",
    "fde",
    "nll",
    "plan_ade",
    "plan_fde",
    "planning_ce",
    "planning_cost",
    "planning_loss",
    "collision_rate",
    "solved",
)


def displacements(
    prefix: str, path: Float[Tensor, "B T 2"], batch: StackBatch
) -> dict[str, Float[Tensor, " B"]]:
    """Average and final distance in m between a path and the human's future."""
    future = batch.ego_future
    error = (path - future.motion.position).square().sum(-1).sqrt()
    return {f"{prefix}ade": _time_mean(error, future.valid), f"{prefix}fde": error[..., -1]}


def _time_mean(values: Float[Tensor, "*b T"], valid: Tensor) -> Float[Tensor, "*b"]:
    kept = torch.where(valid, values, torch.zeros_like(values))
    return kept.sum(-1) / valid.sum(-1).clamp_min(1)


def _masked_mean(values: Float[Tensor, " B"], mask: Tensor) -> Float[Tensor, ""]:
    return torch.where(mask, values, torch.zeros_like(values)).sum() / mask.sum().clamp_min(1)


def assemble(
    dynamics: nn.Module,
    predictor: Predictor | Callable[..., Predictor],
    planner: Callable[..., MPCPlanner],
    **parts: Any,
) -> DiffStackMMV:
    """Build a stack whose predictor and planner share one dynamics model.

    Args:
        dynamics: Dynamics of the ego.
        predictor: A predictor, or what makes one from `ego_dynamics`.
        planner: Makes the planner from `dynamics`.
        parts: The other arguments of `DiffStackMMV`.
    """
    built = predictor if isinstance(predictor, Predictor) else predictor(ego_dynamics=dynamics)
    return DiffStackMMV(predictor=built, planner=planner(dynamics=dynamics), **parts)
