"""The drive that looks at nobody: whom it would hit is in the way."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffstack_mmv.simulation.recorded.passage import Walks


class BlindDrive(NamedTuple):
    """A straight drive from rest at (0, -way / 2) to (0, way / 2)."""

    speed_mps: float
    acceleration_mps2: float
    way_m: float

    def covered(self, time_s: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
        """Way in m that lies behind at some times."""
        ramp_s = self.speed_mps / self.acceleration_mps2
        return np.where(
            time_s < ramp_s,
            0.5 * self.acceleration_mps2 * time_s**2,
            self.speed_mps * (time_s - 0.5 * ramp_s),
        )

    def hits(self, walks: Walks, radius_m: float) -> bool:
        """Whether it comes closer to somebody than the radius of the vehicle, before its end."""
        way = self.covered(walks.step_s * np.arange(walks.inside.shape[1]))
        path = np.stack((np.zeros_like(way), way - self.way_m / 2), -1)
        apart = np.linalg.norm(walks.position - path, axis=-1) - walks.radius[:, None]
        hit = (apart < radius_m) & walks.inside
        return bool(hit[:, way < self.way_m].any())
