"""Pedestrians who stop or turn without a reason that anybody could foresee."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_between
from diffstack_mmv.geometry import length, rotate
from diffstack_mmv.simulation.pedestrians.base import Crowd, CrowdState, VisibleRobot

STANDING_MPS = 1e-3


@dataclass(frozen=True)
class SuddenCrowd:
    """Another crowd, some of whose members stop for a while or turn off for a step.

    Whether somebody does is drawn from a hash of where everybody stands, so that the same state is
    always followed by the same step. Nobody does so before the first step.

    Attributes:
        crowd: What they do otherwise.
        stop_chance: Probability per step that a walking pedestrian stops.
        stay_chance: Probability per step that one who has stopped stays.
        turn_chance: Probability per step that one turns off to either side.
        turn_deg: By how much.
        seed: Of the draws.

    Raises:
        ValueError: A probability lies outside of [0, 1], or the seed is negative.
    """

    crowd: Crowd
    stop_chance: float = 0.05
    stay_chance: float = 0.75
    turn_chance: float = 0.05
    turn_deg: float = 75.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        for name in ("stop_chance", "stay_chance", "turn_chance"):
            require_between(name, getattr(self, name), 0, 1)
        require_at_least("seed", self.seed, 0)

    def __call__(
        self, crowd: CrowdState, dt_s: float, robot: VisibleRobot | None = None
    ) -> Float[Tensor, "*b h 2"]:
        """Velocities in m/s for the next step."""
        velocity = self.crowd(crowd, dt_s, robot)
        if crowd.radius.shape[-1] == 0:
            return velocity
        begun = (length(crowd.velocity) > STANDING_MPS).any(-1, keepdim=True)
        standing = length(crowd.velocity) <= STANDING_MPS
        chance = torch.where(standing, self.stay_chance, self.stop_chance)
        stops = begun & (self._drawn(crowd, 1) < chance)
        draw = self._drawn(crowd, 2)
        angle = math.radians(self.turn_deg) * torch.where(draw < 0.5 * self.turn_chance, 1.0, -1.0)
        turned = rotate(velocity, angle.to(velocity))
        velocity = torch.where((begun & (draw < self.turn_chance))[..., None], turned, velocity)
        return torch.where(stops[..., None], torch.zeros_like(velocity), velocity)

    def _drawn(self, crowd: CrowdState, number: int) -> Float[Tensor, "*b h"]:
        return random_looking(crowd.position, number, self.seed)


def random_looking(
    position: Float[Tensor, "*b h 2"], number: int, seed: int
) -> Float[Tensor, "*b h"]:
    """Numbers in [0, 1) that look random: those of places a micrometre apart differ.

    Args:
        position: Where everybody stands, m.
        number: Which of several draws at the same place.
        seed: Of all draws.
    """
    x, y = position.double().unbind(-1)
    mixed = 12.9898 * x + 78.233 * y + 37.719 * number + 0.6180339887 * seed
    return (mixed.sin() * 43758.5453).remainder(1.0)
