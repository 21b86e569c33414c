"""Pedestrians forecast by a predictor, as it was trained on recordings."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_multiple, require_positive
from diffstack_mmv.geometry import between_rows, length, rotate, times_ahead, wrap_angle
from diffstack_mmv.prediction import Predictor, forecasts_of, strongest
from diffstack_mmv.simulation.forecasters import PedestrianForecast
from diffstack_mmv.simulation.observation import Observation
from diffstack_mmv.types import Forecast, Mode, Motion, Tracks, map_tensors

STANDSTILL_MPS = 0.1
"""Below this speed the last heading stays."""


class _Seen(NamedTuple):
    """One observation of the pedestrians."""

    time: float  # s
    position: Float[Tensor, "*b h 2"]  # m
    velocity: Float[Tensor, "*b h 2"]  # m/s
    present: Bool[Tensor, "*b h"]


@dataclass(frozen=True)
class LearnedForecaster:
    """Everybody goes where a predictor expects it: its likeliest components for each pedestrian.

    What was observed is resampled to the step of the predictor (the pedestrians move straight
    between two observations), what was seen of them before the start included. Rows before the
    first observation of a pedestrian are not valid, and the forecast is resampled to the step of
    the plan; beyond the predictor's horizon the last velocity holds on. Where its step is longer
    than that of the observations, velocities are means over its step, as in the tracks of that
    step it was trained on. A predictor that forecasts egos only has everybody as its ego once.
    The robot is no part of the scene, since the pedestrians do not see it. All episodes and
    pedestrians are one batch. A gradient reaches the predictor.

    Attributes:
        predictor: The predictor, in evaluation mode.
        history_s: Length of the past that it is shown, a multiple of its step.
        components: At most so many components of each pedestrian are kept.

    Raises:
        ValueError: The length is not positive or no multiple of the predictor's step, or no
            component is kept.
    """

    predictor: Predictor
    history_s: float = 4.0
    components: int = 5

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_positive("history_s", self.history_s)
        require_multiple("history_s", self.history_s, self.predictor.dt_s, "for the predictor")
        require_at_least("components", self.components, 1)

    def init(self, observation: Observation) -> tuple[_Seen, ...]:
        """What was seen before the start."""
        before = observation.history
        if before is None:
            return ()
        rows = before.present.shape[-1]
        now = float(observation.time.max())
        return tuple(
            _Seen(
                now - (rows - row) * before.step_s,
                before.position[..., row, :],
                before.velocity[..., row, :],
                before.present[..., row],
            )
            for row in range(rows)
        )

    def __call__(
        self, state: tuple[_Seen, ...], observation: Observation, dt_s: float, steps: int
    ) -> PedestrianForecast:
        """The likeliest components of the predictor."""
        seen = self._seen(state, observation)
        neighbors = self._tracks(seen, observation)
        likely = strongest(forecasts_of(self.predictor, neighbors), self.components)
        now = observation.pedestrian_position[..., None, None, :].to(likely.mean)
        path = torch.cat((now.expand_as(likely.mean[..., :1, :]), likely.mean), -2)
        place = times_ahead(path, steps, dt_s / self.predictor.dt_s)  # in rows of the path
        last = likely.scale_tril.shape[-3] - 1
        scale = between_rows(likely.scale_tril.flatten(-2), (place - 1).clamp(0, last))
        forecast = Forecast(
            likely.log_weight, between_rows(path, place), scale.unflatten(-1, (2, 2))
        )
        wide = map_tensors(lambda entry: entry.to(observation.pedestrian_position.dtype), forecast)
        return PedestrianForecast(wide, seen)

    def _seen(self, state: tuple[_Seen, ...], observation: Observation) -> tuple[_Seen, ...]:
        """What was seen so far, without what is too old."""
        time = float(observation.time.max())
        oldest = time - self.history_s
        # one older observation is kept, from which the first row is interpolated
        old = [each for each in state if each.time <= oldest][-1:]
        recent = [each for each in state if each.time > oldest]
        present = observation.seen
        # who is absent is far away, which is nothing to interpolate with
        nowhere = torch.zeros_like(observation.pedestrian_position)
        position = torch.where(present[..., None], observation.pedestrian_position, nowhere)
        now = _Seen(time, position, observation.pedestrian_velocity, present)
        return (*old, *recent, now)

    def _tracks(self, seen: tuple[_Seen, ...], observation: Observation) -> Tracks:
        """The pedestrians as the predictor wants them, in float32."""
        step_s = self.predictor.dt_s
        rows = require_multiple("history_s", self.history_s, step_s, "for the predictor") + 1
        first, now = seen[0].time, seen[-1].time
        interval_s = (now - first) / max(len(seen) - 1, 1) or step_s
        time = now - step_s * torch.arange(rows - 1, -1, -1, dtype=torch.float64)
        place = (time - first) / interval_s
        known = place > -1e-6
        place = place.clamp(0, len(seen) - 1)
        present = torch.stack([each.present for each in seen], -1)
        lower, upper = (place + 1e-6).floor().long(), (place - 1e-6).ceil().long().clamp(min=0)
        valid = present[..., lower] & present[..., upper] & known.to(present.device)
        position = between_rows(torch.stack([each.position for each in seen], -2), place)
        # a velocity holds up to the observation that tells of it
        velocities = torch.stack([each.velocity for each in seen], -2)
        velocity = velocities[..., upper, :]
        if step_s > interval_s:
            velocity = _since_last_row(position, velocity, valid, step_s)
        heading = last_heading(velocity, valid)
        turned = wrap_angle(heading.diff(dim=-1)) / step_s * (valid[..., 1:] & valid[..., :-1])
        motion = Motion(
            position=position,
            heading=heading,
            velocity=rotate(velocity, -heading),
            yaw_rate=torch.cat((torch.zeros_like(turned[..., :1]), turned), -1),
        )
        size = 2 * observation.pedestrian_radius
        return Tracks(
            motion=Motion(*(entry.float() for entry in motion)),
            extent=torch.stack((size, size), -1).float(),
            mode=torch.full_like(size, int(Mode.PEDESTRIAN), dtype=torch.long),
            valid=valid,
        )


def last_heading(
    velocity: Float[Tensor, "*b T 2"], valid: Bool[Tensor, "*b T"] | Bool[Tensor, " T"]
) -> Float[Tensor, "*b T"]:
    """Course in rad, at rest the last one before; before the first motion that of the first motion.

    Args:
        velocity: In m/s.
        valid: Rows that count.

    Returns:
        The heading, zero for who never moves.
    """
    course = torch.atan2(velocity[..., 1], velocity[..., 0])
    moving = (length(velocity) > STANDSTILL_MPS) & valid
    row = torch.arange(course.shape[-1], device=course.device)
    last = torch.where(moving, row, -1).cummax(-1).values
    first = moving.long().argmax(-1, keepdim=True)
    heading = course.take_along_dim(torch.where(last < 0, first, last), -1)
    return torch.where(moving.any(-1, keepdim=True), heading, torch.zeros_like(heading))


def _since_last_row(
    position: Float[Tensor, "*b T 2"],
    velocity: Float[Tensor, "*b T 2"],
    valid: Bool[Tensor, "*b T"],
    step_s: float,
) -> Float[Tensor, "*b T 2"]:
    """Mean velocity since the row before, as unsmoothed tracks have it; without one that given."""
    both = (valid[..., 1:] & valid[..., :-1]).unsqueeze(-1)
    later = torch.where(both, position.diff(dim=-2) / step_s, velocity[..., 1:, :])
    return torch.cat((velocity[..., :1, :], later), -2)
