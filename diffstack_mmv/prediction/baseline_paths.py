"""Trivial answers to the question of the stack: a path of the ego to compare a plan with."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.prediction.base import Predictor, ego_forecast
from diffstack_mmv.types import Forecast, Motion, StackBatch


@runtime_checkable
class Baseline(Protocol):
    """A trivial answer to the same question: a path of the ego."""

    def __call__(self, batch: StackBatch, goal: Float[Tensor, "B 2"]) -> Float[Tensor, "B T 2"]:
        """Path in m in the frame of the sample, given the goal (m) that the plan was given."""
        ...


class PredictedPath:
    """The most likely path of a simple predictor, which knows no goal."""

    def __init__(self, predictor: Predictor) -> None:
        self.predictor = predictor

    def __call__(self, batch: StackBatch, goal: Float[Tensor, "B 2"]) -> Float[Tensor, "B T 2"]:
        """Path in m; the goal is not used."""
        return self.forecast(batch).most_likely()

    def forecast(self, batch: StackBatch) -> Forecast:
        """What it forecasts of the ego, of the shape `B K T`."""
        return ego_forecast(self.predictor.predict(batch))


class PathToGoal:
    """A path in closed form from the present motion to the goal.

    Args:
        path: (motion, goal, steps, dt_s) -> path.
    """

    def __init__(self, path: Callable[[Motion, Tensor, int, float], Tensor]) -> None:
        self.path = path

    def __call__(self, batch: StackBatch, goal: Float[Tensor, "B 2"]) -> Float[Tensor, "B T 2"]:
        """Path in m that ends at the goal."""
        steps = batch.ego_future.valid.shape[-1]
        return self.path(batch.ego_past.present().motion, goal, steps, batch.dt_s)
