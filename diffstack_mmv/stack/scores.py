"""Scores of what a stack made of a batch, by the names of `metrics.OPEN_LOOP`."""

from collections.abc import Mapping

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.metrics import (
    average_displacement,
    best_average_displacement,
    collided,
    displacements,
    final_displacement,
    human_collided,
    missed,
    negative_log_likelihood,
    planning_loss,
    solved,
)
from diffstack_mmv.planning import observed_obstacles
from diffstack_mmv.prediction import combined_path, ego_forecast
from diffstack_mmv.stack.output import StackOutput
from diffstack_mmv.types import Forecast, StackBatch


def prediction_scores(batch: StackBatch, forecast: Forecast) -> dict[str, Float[Tensor, " B"]]:
    """Scores that need no plan, by the names of `OF_THE_PREDICTION`."""
    future, ego = batch.ego_future, ego_forecast(forecast)
    middle, mean = ego.median(), ego.expected()
    paths = {
        "": ego.most_likely(),
        "median_": middle,
        "mean_": mean,
        "combined_": combined_path(middle, mean, batch.ego_past, batch.dt_s),
    }
    return {
        **{
            prefix + score: value
            for prefix, path in paths.items()
            for score, value in displacements(path, future).items()
        },
        "nll": negative_log_likelihood(ego, future),
        "min_ade": best_average_displacement(ego, future),
        "miss_rate": missed(middle, future),
    }


def plan_scores(
    batch: StackBatch,
    output: StackOutput,
    losses: Mapping[str, Float[Tensor, " B"]],
    hindsight: float,
) -> dict[str, Float[Tensor, " B"]]:
    """Scores of the plans.

    Args:
        batch: What was planned for.
        output: What the stages made of it.
        losses: Planning losses of each sample, see `DiffStackMMV.planning_losses`.
        hindsight: Weight of the cost in hindsight in the planning loss.
    """
    future, motion, discs = batch.ego_future, output.plan.motion, output.problem.ego.discs
    ahead = motion.position[..., 1:, :]
    entropy, cost = losses["planning_ce"], losses["planning_cost"]
    truth = observed_obstacles(batch.neighbors_past, batch.neighbors_future)
    return {
        "plan_ade": average_displacement(ahead, future),
        "plan_fde": final_displacement(ahead, future),
        "planning_ce": entropy,
        "planning_cost": cost,
        "planning_loss": planning_loss(entropy, cost, hindsight),
        "collision_rate": collided(motion.position, motion.heading, discs, truth),
        "human_collision_rate": human_collided(batch.ego_past, future, discs, truth),
        "solved": solved(output.plan),
    }
