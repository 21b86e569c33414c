"""Traffic lights of the sample intersection: two phases, in the state codes of IMPTC."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

GREEN, YELLOW, RED, RED_YELLOW = 4, 20, 10, 30

SIGNAL_ARMS = {"k1": 0, "k2": 0, "k3": 1, "k4": 2, "k5": 2, "k6": 3, "f1": 0, "f2": 1, "f3": 2}
"""Arm of the intersection that each signal group controls."""


@dataclass(frozen=True)
class SignalPlan:
    """A fixed cycle; arms 0 and 2 take turns with 1 and 3.

    Attributes:
        offset_s: Time into the cycle at t = 0.
        cycle_s: Length of the cycle.
    """

    offset_s: float
    cycle_s: float = 28.0

    def state(self, arm: NDArray[np.int64], time_s: float) -> NDArray[np.int64]:
        """State code of the light of each arm (n,) at `time_s` s."""
        half = self.cycle_s / 2.0
        phase = (time_s + self.offset_s + (arm % 2) * half) % self.cycle_s
        bounds = np.array([half - 4.0, half - 2.0, self.cycle_s - 1.0])
        codes = np.array([GREEN, YELLOW, RED, RED_YELLOW])
        return codes[np.searchsorted(bounds, phase, side="right")]
