"""People forecast by a predictor, as it was trained on recordings."""

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_multiple, require_positive
from diffstack_mmv.geometry import rotate, wrap_angle
from diffstack_mmv.prediction import Predictor, neighbors_forecast
from diffstack_mmv.simulation.rounding import length
from diffstack_mmv.simulation.world import Observation
from diffstack_mmv.types import Mode, Motion, Tracks, map_tensors

STANDSTILL_MPS = 0.1
"""Below this speed the last heading is held."""


class _Seen(NamedTuple):
    """One observation of the humans."""

    time: float  # s
    position: Float[Tensor, "*b h 2"]  # m
    velocity: Float[Tensor, "*b h 2"]  # m/s


@dataclass
class PredictorPeople:
    """Everybody goes where a predictor expects it: the most likely trajectory of each human.

    What was observed is resampled to the step of the predictor (the humans move straight between
    two observations), rows before the first observation are not valid, and the forecast is
    resampled to the step of the plan; beyond the predictor's horizon the last velocity holds on.
    The robot is no part of the scene, since the humans do not see it. All episodes and humans are
    one batch. A gradient reaches the predictor.

    Attributes:
        predictor: The predictor, in evaluation mode.
        history_s: Length of the past that it is shown, a multiple of its step.

    Raises:
        ValueError: The length is not positive or no multiple of the predictor's step.
    """

    predictor: Predictor
    history_s: float = 4.0
    _seen: list[_Seen] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the length once, at the border."""
        require_positive("history_s", self.history_s)
        require_multiple("history_s", self.history_s, self.predictor.dt_s, "for the predictor")

    def __call__(
        self, observation: Observation, dt_s: float, steps: int
    ) -> Float[Tensor, "*b h T1 2"]:
        """Positions in m of the most likely trajectories."""
        self._remember(observation)
        neighbors = self._tracks(observation)
        forecast = neighbors_forecast(self.predictor(_nobody(neighbors), neighbors)).most_likely()
        now = observation.human_position
        path = torch.cat((now.unsqueeze(-2).to(forecast), forecast), -2)
        place = dt_s / self.predictor.dt_s * torch.arange(steps + 1, dtype=path.dtype)
        future = _at(path, place.to(path.device)).to(now.dtype)
        return torch.cat((now.unsqueeze(-2), future[..., 1:, :]), -2)

    def _remember(self, observation: Observation) -> None:
        """Add an observation, forget those of earlier episodes and those too old."""
        time = float(observation.time.max())
        if bool((observation.time == 0).any()):
            self._seen = []
        oldest = time - self.history_s
        # one older observation is kept, from which the first row is interpolated
        old = [each for each in self._seen if each.time <= oldest][-1:]
        recent = [each for each in self._seen if each.time > oldest]
        now = _Seen(time, observation.human_position, observation.human_velocity)
        self._seen = [*old, *recent, now]

    def _tracks(self, observation: Observation) -> Tracks:
        """The humans as the predictor wants them, in float32."""
        step_s = self.predictor.dt_s
        rows = require_multiple("history_s", self.history_s, step_s, "for the predictor") + 1
        first, now = self._seen[0].time, self._seen[-1].time
        interval_s = (now - first) / max(len(self._seen) - 1, 1) or step_s
        time = now - step_s * torch.arange(rows - 1, -1, -1, dtype=torch.float64)
        place = (time - first) / interval_s
        valid = place > -1e-6
        place = place.clamp(0, len(self._seen) - 1)
        position = _at(torch.stack([each.position for each in self._seen], -2), place)
        # a velocity holds up to the observation that tells of it
        velocities = torch.stack([each.velocity for each in self._seen], -2)
        velocity = velocities[..., (place - 1e-6).ceil().long(), :]
        heading = held_heading(velocity, valid)
        known = valid.expand(heading.shape)
        turned = wrap_angle(heading.diff(dim=-1)) / step_s * (known[..., 1:] & known[..., :-1])
        motion = Motion(
            position=position,
            heading=heading,
            velocity=rotate(velocity, -heading),
            yaw_rate=torch.cat((torch.zeros_like(turned[..., :1]), turned), -1),
        )
        size = 2 * observation.human_radius
        return Tracks(
            motion=Motion(*(entry.float() for entry in motion)),
            extent=torch.stack((size, size), -1).float(),
            mode=torch.full_like(size, int(Mode.PEDESTRIAN), dtype=torch.long),
            valid=known,
        )


def held_heading(
    velocity: Float[Tensor, "*b T 2"], valid: Bool[Tensor, " T"]
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


def _at(rows: Float[Tensor, "*b n 2"], place: Float[Tensor, " k"]) -> Float[Tensor, "*b k 2"]:
    """Values at fractional rows; beyond the last row the last difference goes on."""
    if rows.shape[-2] == 1:
        return rows.expand(*rows.shape[:-2], len(place), 2)
    lower = place.floor().long().clamp(0, rows.shape[-2] - 2)
    share = (place - lower).to(rows).unsqueeze(-1)
    return rows[..., lower, :] + share * (rows[..., lower + 1, :] - rows[..., lower, :])


def _nobody(neighbors: Tracks) -> Tracks:
    """An ego that is not there, beside neighbors `*b h T`."""
    agent_dim = neighbors.mode.dim() - 1
    return map_tensors(lambda entry: torch.zeros_like(entry.select(agent_dim, 0)), neighbors)
