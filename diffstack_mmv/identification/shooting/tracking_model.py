"""The vehicle model that the tracking problem simulates, and its residuals."""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import pad

from diffstack_mmv.checks import message, require
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.geometry import rotate
from diffstack_mmv.identification.shooting.intervals import interval_count, node_times
from diffstack_mmv.identification.shooting.problem import (
    COMMAND_DIM,
    Measurements,
    TrackingProblem,
    Unknowns,
)
from diffstack_mmv.identification.shooting.settings import TrackingSettings
from diffstack_mmv.identification.tracks.instruments import recorded_controls
from diffstack_mmv.identification.tracks.segments import SegmentBatch
from diffstack_mmv.types import Motion

SLOWEST_MPS = 1.0  # for curvatures of the guess
ACCELERATION = "acceleration"
"""The control whose bounds the rider's command keeps."""


def require_driven(model: DynamicsModel) -> None:
    """Refuse a model that no rider drives by an acceleration: its tracks tell nothing of it.

    Raises:
        ValueError: The acceleration is none of its controls.
    """
    own, name = model.Control._fields, type(model).__name__
    needs = f"have the control `{ACCELERATION}` to be identified"
    found = f"{name} with {', '.join(own)}"
    remedy = "Choose a model of a vehicle: gm3, kbm or unicycle, in any of their forms."
    require(ACCELERATION in own, "dynamics", needs, found, "", remedy)


class TrackingModel(nn.Module):
    """A model with the rider's command as part of its state, and the residuals of tracking.

    The state is (x, a, κ, u_before): that of the model, the command, and the control before.

    Args:
        model: The dynamics.
        settings: Noise and regularisation.

    Raises:
        ValueError: The number of noises of controls is not that of the model's controls, or the
            model is driven by no acceleration.
    """

    def __init__(self, model: DynamicsModel, settings: TrackingSettings) -> None:
        super().__init__()
        require_driven(model)
        noise = settings.control_noise
        if noise is not None:
            count = model.control_dim
            require(len(noise) == count, "control_noise", f"have {count} entries", len(noise))
        self.model = model
        self.settings = settings
        names = model.Control._fields
        self.steer = names.index("steer") if "steer" in names else None
        like = model.bounds.lower
        rate_scale = [settings.jerk_mps3 * model.dt_s, settings.curvature_rate * model.dt_s]
        self.register_buffer("rate_scale", like.new_tensor(rate_scale))
        self.register_buffer("initial_scale", like.new_tensor(self._initial_scale()))
        self.register_buffer(
            "position_noise", like.new_tensor([settings.along_m, settings.across_m])
        )

    def _initial_scale(self) -> list[float]:
        settings = self.settings
        place = [settings.start_position_m] * 2
        motion = [settings.start_course_rad, settings.start_speed_mps]
        # the command may start anywhere within a second of its rate
        return [*place, *motion, settings.jerk_mps3, settings.curvature_rate]

    @property
    def state_dim(self) -> int:
        """Columns of the extended state."""
        return self.model.state_dim + COMMAND_DIM + self.model.control_dim

    def split(self, state: Float[Tensor, "*b s"]) -> tuple[Tensor, Tensor, Tensor]:
        """State of the model, command, control before."""
        widths = [self.model.state_dim, COMMAND_DIM, self.model.control_dim]
        plain, command, before = state.split(widths, -1)
        return plain, command, before

    def initial_state(
        self, initial: Float[Tensor, "*b 6"], start: Float[Tensor, "*b 6"]
    ) -> Float[Tensor, "*b s"]:
        """Extended state at the start, from the initial condition in standard deviations."""
        x, y, course, speed, acceleration, curvature = (
            start + self.get_buffer("initial_scale") * initial
        ).unbind(-1)
        velocity = torch.stack([speed, torch.zeros_like(speed)], -1)
        motion = Motion(torch.stack([x, y], -1), course, velocity, speed * curvature)
        state = self.model.state_on_course(motion)
        control = self.model.control_for(state, acceleration, curvature)
        return torch.cat([state, torch.stack([acceleration, curvature], -1), control], -1)

    def step(
        self, state: Float[Tensor, "*b s"], rates: Float[Tensor, "*b 2"]
    ) -> Float[Tensor, "*b s"]:
        """Extended state one step later."""
        plain, command, _ = self.split(state)
        control = self.model.control_for(plain, command[..., 0], command[..., 1])
        following = self.model.step(plain, control)
        return torch.cat([following, command + self.get_buffer("rate_scale") * rates, control], -1)

    @property
    def has_steering_prior(self) -> bool:
        """Whether the steering rate is one of the residuals."""
        return self.settings.steer_rate_radps is not None and self.steer is not None

    def recorded_columns(self, count: int) -> list[int]:
        """Which of the `count` residuals of a time are of recorded numbers, not of the prior."""
        prior = {2} if self.has_steering_prior else set()
        return [column for column in range(count) if column not in prior]

    def residual(
        self, state: Float[Tensor, "*b s"], measured: Measurements
    ) -> Float[Tensor, "*b k"]:
        """Residuals of one time in standard deviations: position, steering rate, controls."""
        plain, command, before = self.split(state)
        control = self.model.control_for(plain, command[..., 0], command[..., 1])
        position = self.model.motion(plain, control).position
        error = rotate(position - measured.position, -measured.course)
        scaled = error / self.get_buffer("position_noise")
        parts = [scaled * measured.weight.unsqueeze(-1)]
        rate = self.settings.steer_rate_radps
        if rate is not None and self.steer is not None:
            change = control[..., self.steer] - before[..., self.steer]
            scale = rate * self.model.dt_s
            parts.append((change * measured.weight / scale).unsqueeze(-1))
        if self.settings.control_noise is not None:
            told = recorded_controls(self.model, plain, control)
            parts.append((told - measured.controls) * measured.control_weight)
        return torch.cat(parts, -1)

    def forward(
        self, state: Float[Tensor, "*b s"], rates: Float[Tensor, "*b 2"], measured: Measurements
    ) -> tuple[Float[Tensor, "*b s"], Float[Tensor, "*b k"]]:
        """The next state, and the residuals of this one."""
        return self.step(state, rates), self.residual(state, measured)

    def problem(self, segments: SegmentBatch) -> TrackingProblem:
        """The tracking problem of recorded segments, with a guess from their differences.

        Raises:
            ValueError: Noise of measured controls is given, but the tracks have none.
        """
        measurements = self._measurements(segments)
        command = self._commands(segments)
        along = torch.stack([segments.course, segments.speed], -1)
        way = torch.cat([segments.position, along, command], -1)
        stages = way.shape[1]
        count = interval_count(stages, self.settings.segment_steps) - 1
        at_nodes = way[:, node_times(stages, count)]
        nodes = self.initial_state(torch.zeros_like(at_nodes), at_nodes).detach()
        rates = command.diff(dim=1) / self.get_buffer("rate_scale")
        guess = Unknowns(torch.zeros_like(way[:, 0]), rates, nodes)
        return TrackingProblem(measurements, way[:, 0], guess)

    def _measurements(self, segments: SegmentBatch) -> Measurements:
        weight = segments.valid.to(segments.position)
        noise, controls = self.settings.control_noise, segments.controls
        if noise is None:
            absent = weight.new_zeros(*weight.shape, self.model.control_dim)
            return Measurements(segments.position, segments.course, weight, absent, absent)
        if controls is None:
            remedy = "The tracks have no controls."
            raise ValueError(message("control_noise", "be null", noise, "", remedy))
        # the last row has no control of its own
        acting = pad(weight[:, 1:], (0, 1)).unsqueeze(-1)
        precision = acting / weight.new_tensor(noise)
        if self.model.acts_a_step_late and not self.settings.own_steps:
            controls = _half_a_step_on(controls)
        return Measurements(segments.position, segments.course, weight, controls, precision)

    def _commands(self, segments: SegmentBatch) -> Float[Tensor, "N T1 2"]:
        """Acceleration and curvature from differences, zero in the padding."""
        dt_s, lower, upper = self.model.dt_s, *self.model.bounds
        speed = 0.5 * (segments.speed[:, 1:] + segments.speed[:, :-1])
        curvature = segments.course.diff(dim=-1) / (dt_s * speed.clamp_min(SLOWEST_MPS))
        acceleration = segments.speed.diff(dim=-1) / dt_s
        which = self.model.Control._fields.index(ACCELERATION)
        acceleration = acceleration.clamp(float(lower[which]), float(upper[which]))
        both = torch.stack([acceleration, curvature], -1)
        return torch.cat([both, both[:, -1:]], 1)


def _half_a_step_on(controls: Float[Tensor, "N T1 m"]) -> Float[Tensor, "N T1 m"]:
    """What a model that acts a step late has to do to move as the recorded vehicle did.

    Its control of a step turns the way from this step to the next. The vehicle turned between the
    two by its control around their border, with weights that fall to zero over a step: exact here
    for controls that are cubic in time. Noise that changes slowly stays as it is.

    Args:
        controls: Means of what was recorded within each step.
    """
    first, last = controls[:, :1], controls[:, -1:]
    around = torch.cat([first, controls, last, last], 1)
    return (13 * (around[:, 1:-2] + around[:, 2:-1]) - around[:, :-3] - around[:, 3:]) / 24
