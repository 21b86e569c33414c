"""What a robot sees of the pedestrians: not those far away or out of view, and not exactly."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require, require_at_least, require_positive
from diffstack_mmv.geometry import wrap_angle
from diffstack_mmv.simulation.case_noise import NoiseSource, case_noise, milliseconds
from diffstack_mmv.simulation.observation import Observation
from diffstack_mmv.simulation.pedestrians.recorded import far_away


@dataclass(frozen=True)
class LimitedSensing:
    """A sensor with a range and a field of view, whose measurements have errors.

    Attributes:
        range_m: Clearance between the discs from which on nobody is seen; no limit if None.
        view_deg: Angle of the field of view around the heading.
        position_noise_m: Standard deviation of each measured coordinate of a pedestrian.
        velocity_noise_mps: Standard deviation of each measured component of its velocity.
        seed: Of the errors; the same seed repeats the same errors.

    Raises:
        ValueError: The range is not positive, the angle outside of (0, 360], or a deviation
            negative.
    """

    range_m: float | None = None
    view_deg: float = 360.0
    position_noise_m: float = 0.0
    velocity_noise_mps: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the settings once, at the border."""
        if self.range_m is not None:
            require_positive("range_m", self.range_m)
        require_positive("view_deg", self.view_deg)
        require(self.view_deg <= 360, "view_deg", "be at most a whole turn, 360", self.view_deg)
        require_at_least("position_noise_m", self.position_noise_m, 0)
        require_at_least("velocity_noise_mps", self.velocity_noise_mps, 0)

    def __call__(self, observation: Observation) -> Observation:
        """The observation without those who are not seen, m and m/s.

        Who is not seen is laid far away. What was recorded of people before the start is not told
        either: a limited sensor knows what it has seen itself.
        """
        if self == LimitedSensing(seed=self.seed):
            return observation
        seen = observation.seen & self._in_sight(observation)
        position = self._disturbed(observation, "position")
        velocity = self._disturbed(observation, "velocity")
        return observation._replace(
            pedestrian_position=torch.where(seen[..., None], position, far_away(position)),
            pedestrian_velocity=torch.where(seen[..., None], velocity, torch.zeros_like(velocity)),
            seen=seen,
            history=None,
        )

    def _in_sight(self, observation: Observation) -> Bool[Tensor, "*b h"]:
        motion = observation.motion
        offset = observation.pedestrian_position - motion.position[..., None, :]
        reach = observation.radius[..., None] + observation.pedestrian_radius
        range_m = math.inf if self.range_m is None else self.range_m
        near = offset.norm(dim=-1) - reach <= range_m
        bearing = torch.atan2(offset[..., 1], offset[..., 0]) - motion.heading[..., None]
        ahead = wrap_angle(bearing).abs() <= 0.5 * math.radians(self.view_deg) + 1e-9
        return near & ahead

    def _disturbed(self, observation: Observation, name: str) -> Float[Tensor, "*b h 2"]:
        """Positions or velocities of the pedestrians as they are measured."""
        truth = getattr(observation, f"pedestrian_{name}")
        position = name == "position"
        deviation = self.position_noise_m if position else self.velocity_noise_mps
        if deviation == 0:
            return truth
        # the same error whatever else is asked of this instant
        source = NoiseSource.POSITIONS if position else NoiseSource.VELOCITIES
        moment = milliseconds(observation.time)
        error = case_noise(source, observation.case, moment, truth.shape[-2:], self.seed)
        return truth + deviation * error.to(truth)
