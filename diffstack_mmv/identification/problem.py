"""The tracking problem: which controls, and which start, explain a recorded track.

It is the same for every model, so that models can be compared by it. The rider's intention is an
acceleration a and a path curvature κ, both piecewise constant; a model turns them into controls of
its own (`DynamicsModel.control_for`). Per track the unknowns are the placement d (position, course,
speed, a, κ at the start, relative to a guess) and the rates c_t of (a, κ):

    min ½ Σ_t |R(p_t - y_t) / σ_pos|² + ½ |c_t|² + ½ |d|² [+ ½ Σ_t ((δ_t - δ_{t-1}) / (σ_δ dt))²]
                                                          [+ ½ Σ_t |(u_t - u_measured) / σ_u|²]

with errors along and across the track. Because the rates are those of the path and not of the
steering angle, the regularisation says nothing about the physical parameters: a longer wheelbase
costs nothing. A prior on the steering rate (σ_δ), which does inform the wheelbase, has to be asked
for.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.checks import require, require_positive
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.geometry import rotate
from diffstack_mmv.identification.segments import node_times, segment_count
from diffstack_mmv.identification.stretches import StretchBatch
from diffstack_mmv.types import Motion

PLACEMENT = 6  # unknowns of the start: x, y, course, speed, acceleration, curvature
INTENTION = 2  # acceleration, curvature
SLOWEST = 1.0  # m/s, for curvatures of the guess


@dataclass(frozen=True)
class TrackingSettings:
    """Noise and regularisation of the tracking problem.

    Args:
        along_m: Standard deviation of recorded positions along the motion.
        across_m: Standard deviation across.
        jerk_mps3: Standard deviation of the rate of the acceleration.
        curvature_rate: Standard deviation of the rate of the curvature, 1/(m s).
        steer_rate_radps: Standard deviation of the steering rate, or None for steering that is
            free. It informs the wheelbase: the estimate scales with it.
        control_noise: Standard deviation of each measured control, where controls were recorded.
        start_position_m: How far the start may lie from the recorded one.
        start_course_rad: Likewise, the course.
        start_speed_mps: Likewise, the speed.
        segment_steps: Largest number of steps between the nodes of multiple shooting; None for
            single shooting.

    Raises:
        ValueError: A number is not positive.
    """

    along_m: float = 0.08
    across_m: float = 0.06
    jerk_mps3: float = 3.0
    curvature_rate: float = 0.5
    steer_rate_radps: float | None = None
    control_noise: tuple[float, ...] | None = None
    start_position_m: float = 0.5
    start_course_rad: float = 0.5
    start_speed_mps: float = 1.0
    segment_steps: int | None = 5

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            numbers = value if isinstance(value, tuple) else (value,)
            for number in numbers:
                if number is not None:
                    require_positive(name, number)


class Targets(NamedTuple):
    """What the states are compared with at each time."""

    position: Float[Tensor, "N T1 2"]  # m
    course: Float[Tensor, "N T1"]  # rad
    weight: Float[Tensor, "N T1"]  # 1 where recorded, 0 in the padding
    controls: Float[Tensor, "N T1 m"]  # measured
    control_weight: Float[Tensor, "N T1 m"]  # 1 / σ_u where measured, else 0


class Unknowns(NamedTuple):
    """What is inferred of each track, in units of the standard deviations."""

    placement: Float[Tensor, "N 6"]
    rates: Float[Tensor, "N T 2"]
    nodes: Float[Tensor, "N m s"]  # states where segments begin, in their own units


class Problem(NamedTuple):
    """Tracks with a guess of how each begins and what the rider intends."""

    targets: Targets
    start: Float[Tensor, "N 6"]  # x, y (m), course (rad), speed (m/s), a (m/s²), κ (1/m)
    guess: Unknowns


class TrackedVehicle(nn.Module):
    """A model with the rider's intention as part of its state, and the residuals of tracking.

    The state is (x, a, κ, u_before): that of the model, the intention, and the control before.

    Args:
        model: The dynamics.
        settings: Noise and regularisation.
    """

    def __init__(self, model: DynamicsModel, settings: TrackingSettings) -> None:
        super().__init__()
        noise = settings.control_noise
        if noise is not None:
            count = model.control_dim
            require(len(noise) == count, "control_noise", f"have {count} entries", len(noise))
        self.model = model
        self.settings = settings
        names = model.Control._fields
        self.steer = names.index("steer") if "steer" in names else None
        like = model.bounds.lower
        pace = [settings.jerk_mps3 * model.dt_s, settings.curvature_rate * model.dt_s]
        self.register_buffer("pace", like.new_tensor(pace))
        self.register_buffer("spread", like.new_tensor(self._start_spread()))
        self.register_buffer("noise", like.new_tensor([settings.along_m, settings.across_m]))

    def _start_spread(self) -> list[float]:
        settings = self.settings
        place = [settings.start_position_m] * 2
        motion = [settings.start_course_rad, settings.start_speed_mps]
        # the intention may start anywhere within a second of its rate
        return [*place, *motion, settings.jerk_mps3, settings.curvature_rate]

    @property
    def state_dim(self) -> int:
        """Columns of the extended state."""
        return self.model.state_dim + INTENTION + self.model.control_dim

    def split(self, state: Float[Tensor, "*b s"]) -> tuple[Tensor, Tensor, Tensor]:
        """State of the model, intention, control before."""
        widths = [self.model.state_dim, INTENTION, self.model.control_dim]
        plain, intention, before = state.split(widths, -1)
        return plain, intention, before

    def place(
        self, placement: Float[Tensor, "*b 6"], start: Float[Tensor, "*b 6"]
    ) -> Float[Tensor, "*b s"]:
        """Extended state at the start."""
        x, y, course, speed, acceleration, curvature = (
            start + self.get_buffer("spread") * placement
        ).unbind(-1)
        velocity = torch.stack([speed, torch.zeros_like(speed)], -1)
        motion = Motion(torch.stack([x, y], -1), course, velocity, speed * curvature)
        state = self.model.state_on_course(motion)
        control = self.model.control_for(state, acceleration, curvature)
        return torch.cat([state, torch.stack([acceleration, curvature], -1), control], -1)

    def advance(
        self, state: Float[Tensor, "*b s"], rates: Float[Tensor, "*b 2"]
    ) -> Float[Tensor, "*b s"]:
        """Extended state one step later."""
        plain, intention, _ = self.split(state)
        control = self.model.control_for(plain, intention[..., 0], intention[..., 1])
        following = self.model.step(plain, control)
        return torch.cat([following, intention + self.get_buffer("pace") * rates, control], -1)

    def residual(self, state: Float[Tensor, "*b s"], target: Targets) -> Float[Tensor, "*b k"]:
        """Residuals of one time in standard deviations: position, steering rate, controls."""
        plain, intention, before = self.split(state)
        control = self.model.control_for(plain, intention[..., 0], intention[..., 1])
        position = self.model.motion(plain, control).position
        error = rotate(position - target.position, -target.course) / self.get_buffer("noise")
        parts = [error * target.weight.unsqueeze(-1)]
        if self.settings.steer_rate_radps is not None and self.steer is not None:
            change = control[..., self.steer] - before[..., self.steer]
            scale = self.settings.steer_rate_radps * self.model.dt_s
            parts.append((change * target.weight / scale).unsqueeze(-1))
        if self.settings.control_noise is not None:
            parts.append((control - target.controls) * target.control_weight)
        return torch.cat(parts, -1)

    def forward(
        self, state: Float[Tensor, "*b s"], rates: Float[Tensor, "*b 2"], target: Targets
    ) -> tuple[Float[Tensor, "*b s"], Float[Tensor, "*b k"]]:
        """The next state, and the residuals of this one."""
        return self.advance(state, rates), self.residual(state, target)

    def problem(self, stretches: StretchBatch) -> Problem:
        """The tracking problem of recorded stretches, with a guess from their differences.

        Raises:
            ValueError: Noise of measured controls is given, but the tracks have none.
        """
        targets = self._targets(stretches)
        intention = self._intention(stretches)
        along = torch.stack([stretches.course, stretches.speed], -1)
        way = torch.cat([stretches.position, along, intention], -1)
        stages = way.shape[1]
        nodes = segment_count(stages, self.settings.segment_steps) - 1
        met = way[:, node_times(stages, nodes)]
        placed = self.place(torch.zeros_like(met), met).detach()
        rates = intention.diff(dim=1) / self.get_buffer("pace")
        guess = Unknowns(torch.zeros_like(way[:, 0]), rates, placed)
        return Problem(targets, way[:, 0], guess)

    def _targets(self, stretches: StretchBatch) -> Targets:
        weight = stretches.valid.to(stretches.position)
        noise, controls = self.settings.control_noise, stretches.controls
        if noise is None:
            absent = weight.new_zeros(*weight.shape, self.model.control_dim)
            return Targets(stretches.position, stretches.course, weight, absent, absent)
        if controls is None:
            require(False, "control_noise", "be null", noise, "", "The tracks have no controls.")
        measured = stretches.position.new_zeros(0) if controls is None else controls
        # the last row has no control of its own
        acting = torch.nn.functional.pad(weight[:, 1:], (0, 1)).unsqueeze(-1)
        precision = acting / weight.new_tensor(noise)
        return Targets(stretches.position, stretches.course, weight, measured, precision)

    def _intention(self, stretches: StretchBatch) -> Float[Tensor, "N T1 2"]:
        """Acceleration and curvature from differences, zero in the padding."""
        dt_s, lower, upper = self.model.dt_s, *self.model.bounds
        speed = 0.5 * (stretches.speed[:, 1:] + stretches.speed[:, :-1])
        curvature = stretches.course.diff(dim=-1) / (dt_s * speed.clamp_min(SLOWEST))
        acceleration = stretches.speed.diff(dim=-1) / dt_s
        which = self.model.Control._fields.index("acceleration")
        acceleration = acceleration.clamp(float(lower[which]), float(upper[which]))
        both = torch.stack([acceleration, curvature], -1)
        return torch.cat([both, both[:, -1:]], 1)
