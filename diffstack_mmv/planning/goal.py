"""Where the goal of a plan comes from."""

from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.planning.conditional import given_end
from diffstack_mmv.types import Forecast, StackBatch


@runtime_checkable
class GoalSource(Protocol):
    """Chooses the goal of each sample; every table names the source it was made with."""

    name: str
    uses_future: bool

    def __call__(self, batch: StackBatch, forecast: Forecast) -> Float[Tensor, "B 2"]:
        """Goal in m in the frame of the sample, given the forecast of the ego (B K T)."""
        ...

    def expected_path(
        self, forecast: Forecast, goal: Float[Tensor, "B 2"]
    ) -> Float[Tensor, "B T 2"]:
        """Where the ego is expected to go, in m, given its forecast (B K T) and the goal."""
        ...


class FutureGoal:
    """The human's position at the horizon: the route is known, as in DMMV."""

    name = "future"
    uses_future = True

    def __call__(self, batch: StackBatch, forecast: Forecast) -> Float[Tensor, "B 2"]:
        """Goal in m from the recording."""
        return batch.goal

    def expected_path(
        self, forecast: Forecast, goal: Float[Tensor, "B 2"]
    ) -> Float[Tensor, "B T 2"]:
        """Median of the forecast given that it ends at the goal, see `given_end`.

        A single path has no alternatives to weigh, and how its error grows was not learned: it is
        left as it is, for `predicted_reference` to bend with the least acceleration.
        """
        alone = forecast.mean.shape[-3] == 1
        return forecast.mean[..., 0, :, :] if alone else given_end(forecast, goal).median()


class WantedGoal:
    """A goal that somebody wishes for, which tells nothing about how the ego moves now.

    What is known of a human's future (`FutureGoal`) also corrects the estimate of the present
    velocity; a wish that the ego will not fulfil by itself must not.
    """

    name = "wanted"
    uses_future = True

    def __call__(self, batch: StackBatch, forecast: Forecast) -> Float[Tensor, "B 2"]:
        """Goal in m, as it was given."""
        return batch.goal

    def expected_path(
        self, forecast: Forecast, goal: Float[Tensor, "B 2"]
    ) -> Float[Tensor, "B T 2"]:
        """Median of the forecast, for `predicted_reference` to bend with the least acceleration."""
        return forecast.median()


class PredictedGoal:
    """The end of the path that the forecast of the ego expects: no future is used at all."""

    name = "predicted"
    uses_future = False

    def __call__(self, batch: StackBatch, forecast: Forecast) -> Float[Tensor, "B 2"]:
        """Goal in m from the forecast."""
        return forecast.median()[..., -1, :]

    def expected_path(
        self, forecast: Forecast, goal: Float[Tensor, "B 2"]
    ) -> Float[Tensor, "B T 2"]:
        """Median of the forecast, which ends at the goal."""
        return forecast.median()
