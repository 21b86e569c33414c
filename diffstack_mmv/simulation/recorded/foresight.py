"""The forecast that nobody has: what the recording holds."""

from dataclasses import dataclass

import torch

from diffstack_mmv.checks import message, require_positive
from diffstack_mmv.geometry import between_rows, times_ahead
from diffstack_mmv.prediction import single_component
from diffstack_mmv.simulation.forecasters import PedestrianForecast
from diffstack_mmv.simulation.observation import Observation

DEVIATION_M = 0.01
"""Standard deviation of the forecast; none at all has no density."""


@dataclass(frozen=True)
class KnownFuture:
    """Everybody goes where the recording says; it shows what a perfect forecast would be worth.

    It needs a world that reveals the recording (`reveals_s`), and is no controller to compare with.

    Attributes:
        world_step_s: Step of the world, from one revealed row to the next.

    Raises:
        ValueError: The step is not positive.
    """

    world_step_s: float = 0.25

    def __post_init__(self) -> None:
        """Check the step once, at the border."""
        require_positive("world_step_s", self.world_step_s)

    def init(self, observation: Observation) -> None:
        """Nothing to remember."""
        return

    def __call__(
        self, state: None, observation: Observation, dt_s: float, steps: int
    ) -> PedestrianForecast:
        """One component along the recorded way, almost without spread.

        Raises:
            ValueError: The world reveals nothing.
        """
        future = observation.future
        if future is None:
            remedy = "Set world.reveals_s to the horizon of the plan."
            raise ValueError(message("reveals_s", "be positive for this forecast", 0, "", remedy))
        path = torch.cat((observation.pedestrian_position.unsqueeze(-2), future), -2)
        place = times_ahead(path, steps, dt_s / self.world_step_s)  # in rows of the path
        mean = between_rows(path, place.clamp(max=path.shape[-2] - 1))
        scale = DEVIATION_M * torch.eye(2, dtype=mean.dtype, device=mean.device)
        scale = scale.expand(*mean.shape, 2)
        return PedestrianForecast(single_component(mean, scale), None)
