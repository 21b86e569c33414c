"""Whether a way among agents is passable for a vehicle that knows where they will be."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from diffstack_mmv.checks import require_positive


@dataclass(frozen=True)
class PassageRules:
    """A search over speeds along a few gentle bends from the start to the goal.

    Time, place and speed lie on a grid on which every step is one of three accelerations, so that
    what is found can be driven by whoever keeps to these limits. Where nothing is found there may
    still be another way.

    Attributes:
        bulges_m: How far each bend leads aside, half way; a straight line for 0.
        speed_max_mps: Largest speed.
        acceleration_mps2: Acceleration and deceleration.
        margin_m: Clearance that is kept between two discs.

    Raises:
        ValueError: A limit is not positive.
    """

    bulges_m: tuple[float, ...] = (0.0, 1.5, -1.5, 3.0, -3.0)
    speed_max_mps: float = 2.5
    acceleration_mps2: float = 2.0
    margin_m: float = 0.25

    def __post_init__(self) -> None:
        """Check the limits once, at the border."""
        require_positive("speed_max_mps", self.speed_max_mps)
        require_positive("acceleration_mps2", self.acceleration_mps2)
        require_positive("margin_m", self.margin_m)

    def passable(self, walks: "Walks", way_m: float, radius_m: float) -> bool:
        """Whether some drive from (0, -way / 2) to (0, way / 2) keeps clear of everybody.

        Args:
            walks: The agents from the start on.
            way_m: Length of the straight way.
            radius_m: Radius of the vehicle.
        """
        speed_step = self.acceleration_mps2 * walks.step_s
        place_step = 0.5 * speed_step * walks.step_s
        speeds = int(self.speed_max_mps / speed_step + 1e-9) + 1
        for bulge in self.bulges_m:
            path = _bend(way_m, bulge, place_step)
            if _reaches_end(walks.free(path, radius_m + self.margin_m), speeds):
                return True
        return False


@dataclass(frozen=True)
class Walks:
    """Where agents are, row by row.

    Attributes:
        position: In m, (agents, rows, 2).
        inside: Who is there in which row, (agents, rows).
        radius: In m, (agents,).
        step_s: From one row to the next.
    """

    position: NDArray[np.float64]
    inside: NDArray[np.bool_]
    radius: NDArray[np.float64]
    step_s: float

    def free(
        self, path: Float[np.ndarray, "points 2"], apart_m: float
    ) -> Bool[np.ndarray, "rows points"]:
        """Which points of a path are further than `apart_m` from the outline of everybody.

        Args:
            path: Points in m.
            apart_m: Distance in m.
        """
        offset = self.position[:, :, None, :] - path
        squared = np.square(offset).sum(-1)
        near = squared < np.square(self.radius + apart_m)[:, None, None]
        return ~(near & self.inside[:, :, None]).any(0)


def _bend(way_m: float, bulge_m: float, step_m: float) -> NDArray[np.float64]:
    """Points of a bend in m, equally far apart: x = b sin²(πu), y = w (u - 1/2)."""
    share = np.linspace(0, 1, 512)
    points = np.stack((bulge_m * np.sin(np.pi * share) ** 2, way_m * (share - 0.5)), -1)
    along = np.concatenate(([0.0], np.linalg.norm(np.diff(points, axis=0), axis=-1).cumsum()))
    wanted = np.arange(0.0, along[-1], step_m)
    return np.stack([np.interp(wanted, along, column) for column in points.T], -1)


def _reaches_end(free: NDArray[np.bool_], speeds: int) -> bool:
    """Whether a drive on the grid passes free points only, from rest to the last point.

    In a step the speed index changes by at most one, and the place by the sum of the old and the
    new index.
    """
    reached = np.zeros((speeds, free.shape[1]), dtype=bool)
    reached[0, 0] = free[0, 0]
    for row in free[1:]:
        after = np.zeros_like(reached)
        for old in range(speeds):
            for new in range(max(old - 1, 0), min(old + 2, speeds)):
                moved = old + new
                after[new, moved:] |= reached[old, : free.shape[1] - moved]
                if moved and reached[old, -moved:].any():
                    return True
        reached = after & row
        if not reached.any():
            return False
    return False
