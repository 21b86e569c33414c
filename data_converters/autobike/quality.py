"""Whether positions, gyroscope and wheel of a log agree with each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from data_converters.autobike.reader import Log
from data_converters.errors import RejectReason, refuse_track

Array = NDArray[np.float64]

STEP_S = 0.1
WINDOW = 11
"""Samples of the filter of both signals, 1.1 s."""


@dataclass(frozen=True)
class LogQuality:
    """What a log must fulfil to be used.

    The rates that positions and gyroscope tell are compared while the bicycle rides. On a straight
    run the correlation is low because there is nothing to correlate: there the residual counts.

    Attributes:
        moving_s: Shortest time in s that it rides.
        riding_mps: Speed in m/s from which it rides.
        speed_ratio: Smallest and largest ratio of wheel to position speed, in the median.
        residual_radps: Residual of the yaw rates in rad/s up to which they agree.
        correlation: Correlation of the yaw rates from which they agree.
        wheel_radius_m: Nominal radius in m.
    """

    moving_s: float = 8.0
    riding_mps: float = 1.5
    speed_ratio: tuple[float, float] = (0.85, 1.15)
    residual_radps: float = 0.1
    correlation: float = 0.85
    wheel_radius_m: float = 0.35

    def check(self, log: Log, where: object) -> None:
        """Refuse a log whose sensors do not agree.

        Raises:
            TrackError: If it rides too briefly, or wheel or gyroscope disagree with the positions.
        """
        at_s = np.arange(log.fixes.time_s[0], log.fixes.time_s[-1], STEP_S)
        if len(at_s) < 2 * WINDOW:
            self._refuse_short(len(at_s) * STEP_S, where)
        speed, yaw_rate = _from_positions(log, at_s)
        riding = speed > self.riding_mps
        if riding.sum() * STEP_S < self.moving_s:
            self._refuse_short(riding.sum() * STEP_S, where)
        wheel, gyro = (_filtered(log, name, at_s) for name in ("wheel_speed", "yaw_rate"))
        ratio = float(np.median(self.wheel_radius_m * wheel[riding] / speed[riding]))
        low, high = self.speed_ratio
        if not low <= ratio <= high:
            needs, remedy = (
                f"be {low:g} to {high:g} times the speed of the positions",
                "Dead wheel?",
            )
            refuse_track(RejectReason.WHEEL_SPEED, "speed", needs, round(ratio, 3), where, remedy)
        difference = (yaw_rate - gyro)[riding]
        residual = float(np.std(difference))
        together = float(np.corrcoef(yaw_rate[riding], gyro[riding])[0, 1])
        if residual > self.residual_radps and not together >= self.correlation:
            needs = f"agree within {self.residual_radps:g} rad/s or correlate {self.correlation:g}"
            found = f"{residual:.3f} rad/s, correlation {together:.2f}"
            remedy = "The positions or the gyroscope are wrong."
            refuse_track(RejectReason.GYRO, "yaw rate", needs, found, where, remedy)

    def _refuse_short(self, seconds: float, where: object) -> None:
        needs, found = f"ride for {self.moving_s:g} s", f"{seconds:.1f} s"
        remedy = "Lower `moving_s` to keep it."
        refuse_track(RejectReason.TOO_SHORT, "log", needs, found, where, remedy)


def _from_positions(log: Log, at_s: Array) -> tuple[Array, Array]:
    """Speed (m,) in m/s and yaw rate (m,) in rad/s of the path."""
    fixes = log.fixes
    path = np.stack([np.interp(at_s, fixes.time_s, axis) for axis in fixes.position.T])
    rate, curvature = (
        np.asarray(savgol_filter(path, WINDOW, 2, deriv=d, delta=STEP_S)) for d in (1, 2)
    )
    speed = np.hypot(rate[0], rate[1])
    turned = rate[0] * curvature[1] - rate[1] * curvature[0]
    return speed, turned / np.maximum(speed, 0.3) ** 2


def _filtered(log: Log, name: str, at_s: Array) -> Array:
    values = log.sensors[name].to_numpy()
    known = np.isfinite(values)
    if not known.any():
        return np.zeros_like(at_s)
    values = np.interp(at_s, log.time_s[known], values[known])
    return np.asarray(savgol_filter(values, WINDOW, 2))
