"""The stack: the one place where prediction, planning and their losses meet."""

from collections.abc import Callable, Mapping
from typing import Any

import pytorch_lightning as pl
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from diffstack_mmv.checks import require, require_at_least, require_whole
from diffstack_mmv.metrics import (
    OF_THE_PREDICTION,
    OPEN_LOOP,
    MeanByMode,
    masked_mean,
    planning_loss,
    solved,
    total_cost,
    where_known,
)
from diffstack_mmv.planning import (
    GoalSource,
    MPCPlanner,
    build_problem,
    closest_candidate,
    cross_entropy,
    disc_radius,
    generated_moments,
    observed_obstacles,
    predicted_obstacles,
    predicted_reference,
    tracked_ego,
)
from diffstack_mmv.prediction import (
    Predictor,
    all_agents,
    ego_forecast,
    motion_along,
    neighbors_forecast,
    strongest,
)
from diffstack_mmv.stack.loss import LossWeights
from diffstack_mmv.stack.output import StackOutput
from diffstack_mmv.stack.physics import PhysicsLearning
from diffstack_mmv.stack.precision import MixedPrecision
from diffstack_mmv.stack.scores import plan_scores, prediction_scores
from diffstack_mmv.types import Forecast, StackBatch
from dmmv_conventions.memory import keep_freed, leave_alone


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
        precision: Precision of the layers of the predictor; float32 if none is given.
        physics: Which physical parameters are learned; all that the vehicle allows, at the rate of
            the networks, if none is given.

    Raises:
        ValueError: No neighbor has a component left, or a physical parameter that is to be learned
            is unknown.
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
        precision: MixedPrecision | None = None,
        physics: PhysicsLearning | None = None,
    ) -> None:
        super().__init__()
        require_whole("obstacle_components", obstacle_components)
        require_at_least("obstacle_components", obstacle_components, 1)
        if precision is not None:
            precision.apply(predictor)
        self.predictor = predictor
        self.planner = planner
        self.physics = physics or PhysicsLearning(rate=1.0)
        self.physics.freeze(planner.dynamics)
        self.goal = goal
        self.loss_weights = loss
        self.optimizer = optimizer
        self.scheduler = scheduler
        self.obstacle_components = obstacle_components
        self.scores = MeanByMode(tuple(OPEN_LOOP) if loss.plans else OF_THE_PREDICTION)

    def compile_kernels(self) -> None:
        """Have solver and expensive parts of the predictor compiled at their next use.

        The process keeps memory that it frees from now on: states that libraries keep for their
        backward pass are large blocks, the same in every step. What exists now counts as kept for
        good.
        """
        keep_freed()
        leave_alone()
        self.planner.compile_solver()
        self.predictor.compile_kernels(generated_moments)

    def forward(self, batch: StackBatch) -> StackOutput:
        """Predict all agents, choose the goal, and plan."""
        return self.plan(batch, self.predictor.predict(batch))

    def plan(
        self, batch: StackBatch, forecast: Forecast, source: GoalSource | None = None
    ) -> StackOutput:
        """Choose the goal and plan, given a forecast of all agents.

        Args:
            batch: Samples.
            forecast: Of all their agents, `B 1+N`.
            source: Where the goal comes from, if not from where the stack itself takes it.
        """
        source = source or self.goal
        ego = ego_forecast(forecast)
        goal = source(batch, ego)
        neighbors = batch.neighbors_past.present()
        obstacles = predicted_obstacles(
            neighbors.motion.position,
            disc_radius(neighbors.extent),
            neighbors.valid,
            strongest(neighbors_forecast(forecast), self.obstacle_components),
        )
        path = source.expected_path(ego, goal)
        motion = motion_along(path, batch.ego_past, batch.dt_s)
        reference = predicted_reference(motion, path, goal, batch.dt_s)
        tracked = tracked_ego(motion, batch.ego_past.extent, goal)
        problem = build_problem(tracked, goal, reference, obstacles)
        return StackOutput(forecast, goal, problem, self.planner(problem))

    def planning_losses(
        self,
        batch: StackBatch,
        output: StackOutput,
        costs: Mapping[str, Float[Tensor, " B"]] | None = None,
    ) -> dict[str, Float[Tensor, " B"]]:
        """Losses of each sample: `planning_ce` in nats, `planning_cost` (1), `control` in m² or m.

        NaN where the human's future or the goal of the plan was not recorded.

        Args:
            batch: What was planned for.
            output: What the stages made of it.
            costs: Its `hindsight_costs` if they are known, else computed here.
        """
        future, plan = batch.ego_future, output.plan
        costs = self.hindsight_costs(batch, output) if costs is None else costs
        target = closest_candidate(
            plan.candidates.position[..., 1:, :], future.motion.position, future.valid
        )
        losses = {
            "planning_ce": cross_entropy(plan.logits, target),
            "planning_cost": total_cost(costs),
            "control": self.loss_weights.imitation(plan.motion.position[..., 1:, :], future),
        }
        judged = self._plan_judged(batch)
        return {name: where_known(value, judged) for name, value in losses.items()}

    def hindsight_costs(
        self, batch: StackBatch, output: StackOutput
    ) -> dict[str, Float[Tensor, " B"]]:
        """Cost of each plan under the true futures of the other agents, by term, dimensionless."""
        truth = observed_obstacles(batch.neighbors_past, batch.neighbors_future).of_valid()
        return self.planner.hindsight_cost(output.plan, output.problem._replace(obstacles=truth))

    def _plan_judged(self, batch: StackBatch) -> Bool[Tensor, " B"]:
        """Whether there is a human's future to compare the plan with, and a goal to plan to."""
        return batch.ego_future.valid.any(-1) & self.goal_known(batch)

    def goal_known(self, batch: StackBatch) -> Bool[Tensor, " B"]:
        """Whether the goal of the plan is one: a goal from a recording that ended before is not."""
        recorded = batch.ego_future.valid[..., -1]
        return recorded if self.goal.uses_future else torch.ones_like(recorded)

    def training_step(self, batch: StackBatch, batch_idx: int) -> Tensor:
        """Weighted sum of the losses, shape (), each a mean over the samples that it can judge.

        Nothing is planned where planning and control weigh nothing.
        """
        weights = self.loss_weights
        if weights.plans:
            forecast, judged = self.predictor.predict_and_judge(batch)
            means = self._planning_means(batch, self.plan(batch, forecast))
            planning = planning_loss(
                means["planning_ce"], means["planning_cost"], weights.hindsight
            )
            loss = weights.planning * planning + weights.control * means["control"]
        else:
            judged, means = self.predictor.loss(batch), {}
            loss = judged.new_zeros(())
        means["prediction"] = masked_mean(judged, _has_future(batch))
        loss = loss + weights.prediction * means["prediction"]
        logged = {f"train/{name}": value.detach() for name, value in means.items()}
        self.log_dict(logged | {"train/loss": loss.detach()}, batch_size=len(batch.goal))
        return loss

    def _planning_means(self, batch: StackBatch, output: StackOutput) -> dict[str, Tensor]:
        """Means of the planning losses.

        A plan without solution only counts in the cross entropy.
        """
        losses = self.planning_losses(batch, output)
        judged = self._plan_judged(batch)
        converged = judged & output.plan.converged
        return {
            "planning_ce": masked_mean(losses["planning_ce"], judged),
            "planning_cost": masked_mean(losses["planning_cost"], converged),
            "control": masked_mean(losses["control"], converged),
            "solved": solved(output.plan).mean(),
        }

    def validation_step(self, batch: StackBatch, batch_idx: int) -> None:
        """Add the scores of a batch to the means by mode; nothing is planned for a loss without."""
        if self.loss_weights.plans:
            scores = self.sample_scores(batch)
        else:
            scores = prediction_scores(batch, self.predictor.predict(batch))
        self.scores.update(scores, batch.ego_past.mode)

    def on_validation_epoch_end(self) -> None:
        """Log the means and the numbers of samples not judged, reduced over all processes."""
        for name, value in self.scores.compute().items():
            self.log(f"val/{name}", value)
        self.scores.reset()

    def predict_step(self, batch: StackBatch, batch_idx: int) -> dict[str, Tensor]:
        """Scores of each sample, (B,)."""
        return self.sample_scores(batch)

    def sample_scores(self, batch: StackBatch) -> dict[str, Float[Tensor, " B"]]:
        """Every score of each sample, by the names of `OPEN_LOOP`."""
        return self.score(batch, self(batch))

    def score(
        self,
        batch: StackBatch,
        output: StackOutput,
        costs: Mapping[str, Float[Tensor, " B"]] | None = None,
    ) -> dict[str, Float[Tensor, " B"]]:
        """Scores of what the stages made of a batch, by the names of `OPEN_LOOP`.

        NaN where a sample cannot be judged, of the plans also where their goal is not known.
        Arguments as of `planning_losses`.
        """
        losses, known = self.planning_losses(batch, output, costs), self.goal_known(batch)
        planned = plan_scores(batch, output, losses, self.loss_weights.hindsight)
        scores = prediction_scores(batch, output.forecast) | {
            name: where_known(value, known) for name, value in planned.items()
        }
        return {name: scores[name] for name in OPEN_LOOP}

    def require_learnable(self) -> None:
        """Refuse a stack in which the loss moves nothing, or less than asked for.

        Raises:
            ValueError: The predictor learns nothing and no plan is in the loss, or nothing at all,
                or a physical parameter that was asked for is a constant of the vehicle.
        """
        reached = self if self.loss_weights.plans else self.predictor
        some = any(each.requires_grad for each in reached.parameters())
        wanted = "reach something that is learned"
        found = "a predictor that learns nothing" if reached is not self else "no parameter at all"
        remedy = "Give another predictor or loss, or epochs=0 for a checkpoint of it as it is."
        require(some, "loss", wanted, found, "", remedy)
        self.physics.require_learnable(self.planner.dynamics)

    def configure_optimizers(self) -> Any:
        """Optimizer over all learnable parameters, with its schedule where one is given.

        Raises:
            ValueError: The loss reaches none of them.
        """
        self.require_learnable()
        optimizer = self.physics.optimizer(self.optimizer, self, self.planner.dynamics)
        if self.scheduler is None:
            return optimizer
        return {"optimizer": optimizer, "lr_scheduler": self.scheduler(optimizer=optimizer)}


def _has_future(batch: StackBatch) -> Bool[Tensor, " B"]:
    """Whether any agent that is present now has a recorded future that a loss can judge."""
    past = all_agents(batch.ego_past, batch.neighbors_past)
    future = all_agents(batch.ego_future, batch.neighbors_future)
    return (past.valid[..., -1] & future.valid.any(-1)).any(-1)


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
