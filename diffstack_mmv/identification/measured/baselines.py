"""Lines that need no model of this package, on the same windows, as strong as they can be made.

All start at the last position of the history, in the direction of a quadratic through the positions
of its last second.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.geometry import direction
from diffstack_mmv.identification.measured.rides import RideWindows
from diffstack_mmv.identification.measured.validation import RolloutErrors, errors_of

FIT_STEPS = 10
SPREAD = 1.2
"""Largest ratio of a window's pace to the median one, when the speed scale is fitted."""


class Kinematics(NamedTuple):
    """A kinematic bicycle fitted to rides by regression."""

    wheelbase_m: float
    steer_offset: float  # rad
    speed_scale: float


@dataclass(frozen=True)
class Baselines:
    """Errors of all lines; what they fit comes from the recordings of other folds.

    Attributes:
        history: Steps of the history.
        dt_s: Step in s.
        wheelbase_m: The nominal one.
    """

    history: int
    dt_s: float
    wheelbase_m: float

    def errors(
        self, windows: RideWindows, fitted: RideWindows, folds: list[Bool[Tensor, " recordings"]]
    ) -> Mapping[str, RolloutErrors]:
        """Errors of windows by the name of the line.

        Args:
            windows: History and future.
            fitted: Windows that the bicycle is fitted to.
            folds: Masks of recordings that are left out together.
        """
        found: dict[str, RolloutErrors] = {}
        for fold in folds:
            chosen = fold[windows.recording]
            if not bool(chosen.any()):
                continue
            bicycle = self.fitted(fitted.select(~fold[fitted.recording]))
            part = windows.select(chosen)
            for name, path in self.paths(part, bicycle).items():
                errors = errors_of(path, part, self.history)
                old = found.get(name, RolloutErrors.unknown(windows))
                found[name] = old.filled(chosen, errors)
        return found

    def fitted(self, windows: RideWindows) -> Kinematics:
        """Regression of the turn of the path on the steering, both over the length of a window."""
        pace = self._pace(windows)
        middle = pace.median()
        near = (pace / middle).log().abs() < torch.tensor(SPREAD).log()
        scale = float(pace[near].median())
        chosen = windows.select(near)
        turn, way = self._turned(chosen), scale * chosen.speed[:, :-1] * self.dt_s
        columns = [(way * chosen.steer.tan()).sum(-1), way.sum(-1)]
        per_m, offset = torch.linalg.lstsq(torch.stack(columns, -1), turn).solution.tolist()
        return Kinematics(1 / per_m, offset / per_m, scale)

    def paths(
        self, windows: RideWindows, bicycle: Kinematics
    ) -> dict[str, Float[Tensor, "w T1 2"]]:
        """Positions over the future by the name of the line; those before have no meaning."""
        steer, raw, gyro = windows.steer, windows.speed, windows.yaw_rate
        scaled, zero = bicycle.speed_scale * raw, torch.zeros_like(steer[:, :1])
        nominal, fitted = self.wheelbase_m, bicycle.wheelbase_m
        past = slice(0, self.history)

        def kinematic(length: float, offset: Tensor, speed: Tensor) -> Tensor:
            return self._reckoned(windows, speed[:, :-1] * (steer + offset).tan() / length, speed)

        def from_gyro(length: float) -> Tensor:
            turn, way = gyro[:, past].sum(-1), scaled[:, past].sum(-1)
            return (length * turn / way - steer[:, past].mean(-1)).unsqueeze(-1)

        start = self._turned(windows.head(self.history), FIT_STEPS)
        bias = (gyro[:, past].sum(-1) * self.dt_s - self._turned(windows.head(self.history))) / (
            self.history * self.dt_s
        )
        own = self._pace(windows.head(self.history)).unsqueeze(-1)
        rate = (start / (FIT_STEPS * self.dt_s)).unsqueeze(-1).expand_as(steer)
        steady = self._speed(windows).unsqueeze(-1).expand_as(raw)
        offset = zero + bicycle.steer_offset
        return {
            "constant velocity": self._straight(windows),
            "constant speed and yaw rate": self._reckoned(windows, rate, steady),
            "nominal wheelbase, raw speed": kinematic(nominal, zero, raw),
            "nominal wheelbase, speed scaled": kinematic(nominal, zero, scaled),
            "fitted wheelbase": kinematic(fitted, zero, scaled),
            "fitted wheelbase and offset": kinematic(fitted, offset, scaled),
            "nominal wheelbase, offset by gyro": kinematic(nominal, from_gyro(nominal), scaled),
            "fitted wheelbase, offset by gyro": kinematic(fitted, from_gyro(fitted), scaled),
            "gyro, raw speed": self._reckoned(windows, gyro, raw),
            "gyro, speed scaled": self._reckoned(windows, gyro, scaled),
            "gyro, bias and speed scale of the history": self._reckoned(
                windows, gyro - bias.unsqueeze(-1), own * raw
            ),
        }

    def _straight(self, windows: RideWindows) -> Float[Tensor, "w T1 2"]:
        last = windows.position[:, self.history]
        way = (last - windows.position[:, self.history - 5]) / 5
        ahead = torch.arange(windows.steps + 1, dtype=way.dtype) - self.history
        return last.unsqueeze(1) + ahead.view(1, -1, 1) * way.unsqueeze(1)

    def _speed(self, windows: RideWindows) -> Float[Tensor, " w"]:
        """Mean speed over the last second of the history."""
        last = windows.position[:, self.history - FIT_STEPS : self.history + 1]
        return last.diff(dim=1).norm(dim=-1).mean(-1) / self.dt_s

    def _pace(self, windows: RideWindows) -> Float[Tensor, " w"]:
        """Way of the positions over that of the wheel; chords of half a second leave noise out."""
        chord = (windows.position[:, 5:] - windows.position[:, :-5]).norm(dim=-1)
        wheel = windows.speed[:, :-1].unfold(1, 5, 1).sum(-1) * self.dt_s
        return chord.sum(-1) / wheel.sum(-1)

    def _turned(self, windows: RideWindows, over: int | None = None) -> Float[Tensor, " w"]:
        """Turn of the path in rad over whole windows, or over the last steps of them."""
        first = 0 if over is None else windows.steps - over
        position = windows.position[:, first:]
        half = FIT_STEPS if over is None else over
        start, _ = _headings(position[:, : half + 1], windows.known[:, first : first + half + 1])
        _, end = _headings(position[:, -half - 1 :], windows.known[:, -half - 1 :])
        difference = end - start
        return torch.atan2(difference.sin(), difference.cos())

    def _reckoned(
        self, windows: RideWindows, yaw_rate: Float[Tensor, "w T"], speed: Float[Tensor, "w T1"]
    ) -> Float[Tensor, "w T1 2"]:
        """Path from yaw rates and speed."""
        after = slice(self.history - FIT_STEPS, self.history + 1)
        _, heading = _headings(windows.position[:, after], windows.known[:, after])
        turned = torch.cat([yaw_rate[:, :1] * 0, yaw_rate.cumsum(-1)], -1) * self.dt_s
        turned = turned - (turned[:, self.history] - heading).unsqueeze(-1)
        pace = 0.5 * (speed[:, 1:] + speed[:, :-1]).unsqueeze(-1) * self.dt_s
        steps = pace * direction(0.5 * (turned[:, 1:] + turned[:, :-1]))
        path = torch.cat([steps[:, :1] * 0, steps.cumsum(1)], 1)
        last = slice(self.history, self.history + 1)
        return path - path[:, last] + windows.position[:, last]


def _headings(
    position: Float[Tensor, "w n 2"], known: Bool[Tensor, "w n"]
) -> tuple[Float[Tensor, " w"], Float[Tensor, " w"]]:
    """Directions at both ends of a quadratic through the known positions."""
    steps = torch.arange(position.shape[1], dtype=position.dtype)
    powers = torch.stack([torch.ones_like(steps), steps, steps.square()], -1)
    weight = known.to(position.dtype).clamp_min(1e-3).unsqueeze(-1)
    left = powers.mT @ (weight * powers)
    _, slope, bend = torch.linalg.solve(left, powers.mT @ (weight * position)).unbind(1)
    end = slope + 2 * bend * steps[-1]
    return torch.atan2(slope[:, 1], slope[:, 0]), torch.atan2(end[:, 1], end[:, 0])
