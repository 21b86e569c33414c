"""Where the goal of a plan comes from."""

from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_between
from diffstack_mmv.planning.conditional import given_end
from diffstack_mmv.planning.problem import bent_to_goal, straightened
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
    """The human's position at the horizon: the route is known, as in DMMV.

    Args:
        steadiness: κ of `expected_path`, from 0 to 1.

    Raises:
        ValueError: The steadiness is not in this range.
    """

    name = "future"
    uses_future = True

    def __init__(self, steadiness: float = 0.15) -> None:
        require_between("steadiness", steadiness, 0, 1)
        self.steadiness = steadiness

    def __call__(self, batch: StackBatch, forecast: Forecast) -> Float[Tensor, "B 2"]:
        """Goal in m from the recording."""
        return batch.goal

    def expected_path(
        self, forecast: Forecast, goal: Float[Tensor, "B 2"]
    ) -> Float[Tensor, "B T 2"]:
        """The way to the goal, in the middle of what two estimates and a constant velocity say.

            (1 - κ) m(s) + κ (p₀ + s (g - p₀)),    s = t / T

        with p₀ where the path m begins, half the median of the forecast given that it ends at the
        goal g (`given_end`) and half its median bent to g with the least acceleration
        (`bent_to_goal`): the first moves the present motion as well, the second only what follows.
        Of how m differs from a constant velocity, a share κ is what the end did not tell apart from
        noise.

        A single path is only bent: how its error grows was not learned, nor from whom it comes.
        """
        path = bent_to_goal(forecast.median(), goal)
        if forecast.mean.shape[-3] == 1:
            return path
        path = torch.lerp(path, given_end(forecast, goal).median(), 0.5)
        return torch.lerp(path, straightened(path, goal), self.steadiness)


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
