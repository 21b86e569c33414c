"""The decoder: Gaussian controls of each component, integrated through the dynamics."""

import math
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.prediction.base import GaussianRollout
from diffstack_mmv.prediction.current import Trend, current_course
from diffstack_mmv.prediction.trajectron.agent_batch import AgentBatch
from diffstack_mmv.prediction.trajectron.blocks import Blocks, Scaling
from diffstack_mmv.prediction.trajectron.jacobians import (
    Linearisation,
    linearise,
    linearise_shared,
)
from diffstack_mmv.prediction.trajectron.mixture import PositionMoments, integrate
from diffstack_mmv.prediction.trajectron.recomputed import recomputed
from diffstack_mmv.prediction.trajectron.recurrence import Weights, emissions
from diffstack_mmv.prediction.trajectron.start import StartBlend
from diffstack_mmv.smooth import safe_norm, soft_clamp
from diffstack_mmv.types import Motion, on_host

Jacobians = Callable[[DynamicsModel, Tensor, Tensor], Linearisation]
START_DEVIATION = (0.03, 0.03, 0.05, 0.1)  # m along, m across, rad, m/s before training
START_SCALE = 0.25  # deviation of a control before training, in widths
FADE_S = 0.3  # time constant of acceleration and curvature before training
LOG_RANGE = 4.0  # a deviation stays within a factor of e^4 of its value before training


class ControlDecoder(nn.Module):
    """GRU that emits controls of each component z as deviations from those of a fading CTRA.

        u_t = ū_t + w ∘ W h_t

    with the width w of the box of controls, and ū_t the control for the acceleration a₀ exp(-t / τ)
    and the curvature κ₀ exp(-t / τ), from the component's own start, see `StartBlend`; τ is
    `FADE_S`. Its weights W start at zero, so that an untrained decoder is the fading CTRA and what
    it learns are deviations from it. The input of the GRU is the deviation of the step before;
    context and component enter through its first state and through a constant part of its input,
    which is computed once.

    Args:
        dynamics: Dynamics of the agents.
        context_size: Size of the encoding of the present scene.
        components: Number K of components.
        horizon_steps: Number T of predicted time steps.
        hidden: Size of the state of the GRU.
        dropout: Share of units of the context dropped in training.
        jacobians: Linearises the dynamics, see `integrate`.
        generated: Integrates in one call where it can, see `integrate`.

    Raises:
        ValueError: There is no step.
    """

    def __init__(
        self,
        dynamics: DynamicsModel,
        context_size: int,
        components: int,
        horizon_steps: int,
        hidden: int = 128,
        dropout: float = 0.0,
        jacobians: Jacobians = linearise,
        generated: GaussianRollout | None = None,
    ) -> None:
        super().__init__()
        require_at_least("horizon_steps", horizon_steps, 1)
        self.dynamics, self.horizon_steps = dynamics, horizon_steps
        self.jacobians, self.generated = jacobians, generated
        self.blocks: Blocks | None = None
        size = dynamics.control_dim
        self.dropout = nn.Dropout(dropout)
        self.start = StartBlend(context_size, components)
        self.start_context = nn.Linear(context_size, hidden)
        self.start_component = nn.Parameter(torch.randn(components, hidden) / math.sqrt(hidden))
        self.gate_context = nn.Linear(context_size, 3 * hidden)
        self.gate_component = nn.Parameter(torch.randn(components, 3 * hidden) / math.sqrt(hidden))
        self.gate_control = nn.Linear(size, 3 * hidden, bias=False)
        self.gate_hidden = nn.Linear(hidden, 3 * hidden)
        self.mean_head = nn.Linear(hidden, size)
        self.scale_head = nn.Linear(hidden, size * (size + 1) // 2)
        self.start_head = nn.Linear(hidden, len(START_DEVIATION))
        for head in (self.mean_head, self.scale_head, self.start_head):
            nn.init.zeros_(head.weight)
            nn.init.zeros_(head.bias)
        self.register_buffer("start_deviation", torch.tensor(START_DEVIATION), persistent=False)
        self.start_deviation: Tensor

    def forward(self, context: Float[Tensor, "R c"], rows: AgentBatch) -> PositionMoments:
        """Mean and covariance of the positions `R K T` of the agents, in their own frames.

        The backward pass leaves out components without a gradient, see `recomputed`.
        """
        start = self.start(context, rows.starts)
        motion = present_motion(start, rows)
        context = self.dropout(context)
        hidden = torch.tanh(self.start_context(context).unsqueeze(1) + self.start_component)
        constant = self.gate_context(context).unsqueeze(1) + self.gate_component
        each = [constant, hidden, self._base_controls(motion, start), *motion]
        if self.jacobians is linearise_shared:
            return PositionMoments(*self._moments(*each))
        each = [field.to(self.gate_hidden.weight.dtype) for field in each]
        if self._in_libraries(hidden):
            with torch.autocast(hidden.device.type, enabled=False):
                return PositionMoments(*self._moments(*each))
        each = [field.flatten(0, 1) for field in each]
        moments = recomputed(self._moments, tuple(each), self.parameters())
        return PositionMoments(*(field.unflatten(0, hidden.shape[:2]) for field in moments))

    def compile_kernels(self, moments: GaussianRollout) -> None:
        """Take the recurrence and the integration through all steps in one call from now on.

        The integration only where it is linearised at every point, as `moments` does.
        """
        self.blocks = Blocks()
        if self.jacobians is linearise:
            self.generated = moments

    def _in_libraries(self, hidden: Float[Tensor, "R K h"]) -> bool:
        """Whether libraries take all steps, which leave out rows without a gradient themselves.

        On a GPU the recurrence keeps its states, of which there is room.
        """
        if self.generated is None or self.blocks is None:
            return False
        return not on_host(hidden) or self.blocks.fit(hidden)

    def _moments(
        self,
        constant: Float[Tensor, "*r g"],
        hidden: Float[Tensor, "*r h"],
        base: Float[Tensor, "*#r T m"],
        *motion: Tensor,
    ) -> tuple[Float[Tensor, "*r T 2"], Float[Tensor, "*r T 2 2"]]:
        """Mean and covariance, from the constant input and the first state of the GRU."""
        controls, scale = self._controls(constant, hidden, base)
        spread = self.start_deviation * torch.exp(soft_clamp(self.start_head(hidden), LOG_RANGE))
        moments = integrate(
            self.dynamics, Motion(*motion), controls, scale, spread, self.jacobians, self.generated
        )
        return moments.mean, moments.covariance

    def _controls(
        self,
        constant: Float[Tensor, "*r g"],
        hidden: Float[Tensor, "*r h"],
        base: Float[Tensor, "*#r T m"],
    ) -> tuple[Float[Tensor, "*r T m"], Float[Tensor, "*r T m m"]]:
        """Mean controls and the Cholesky factors of their covariances."""
        width = 0.25 * (self.dynamics.bounds.upper - self.dynamics.bounds.lower)
        weights, leading = self._weights(), hidden.shape[:-1]
        given = hidden, constant, base, *weights
        if self.blocks is not None and self.blocks.fit(*given) and not width.requires_grad:
            scaling = Scaling(width, LOG_RANGE, START_SCALE)
            base = base.expand(*leading, *base.shape[-2:])
            first, second, third = (
                field.flatten(0, len(leading) - 1) for field in (constant, hidden, base)
            )
            found = self.blocks.controls(first, second, third, weights, scaling)
            return found[0].unflatten(0, leading), found[1].unflatten(0, leading)
        deviation, raw_scale = self._emitted(constant, hidden, weights)
        return base + width * deviation, width.unsqueeze(-1) * self._scale(raw_scale)

    def _weights(self) -> Weights:
        """Of the GRU; deviations of the controls are emitted first."""
        return Weights(
            self.gate_control.weight,
            self.gate_hidden.weight,
            self.gate_hidden.bias,
            torch.cat([self.mean_head.weight, self.scale_head.weight]),
            torch.cat([self.mean_head.bias, self.scale_head.bias]),
        )

    def _emitted(
        self, constant: Float[Tensor, "*r g"], hidden: Float[Tensor, "*r h"], weights: Weights
    ) -> tuple[Float[Tensor, "*r T m"], Float[Tensor, "*r T s"]]:
        """Deviations of the controls in widths of their box, and what scales are made of."""
        leading, size = hidden.shape[:-1], self.dynamics.control_dim
        rows = constant.flatten(0, -2), hidden.flatten(0, -2)
        emitted = emissions(*rows, weights, self.horizon_steps).movedim(0, 1).unflatten(0, leading)
        return emitted[..., :size], emitted[..., size:]

    def _scale(self, raw: Float[Tensor, "*r T s"]) -> Float[Tensor, "*r T m m"]:
        """Cholesky factors of the controls' covariance in widths of their box."""
        raw = soft_clamp(raw, LOG_RANGE)
        size = self.dynamics.control_dim
        diagonal = START_SCALE * torch.exp(raw[..., :size])
        factor = torch.diag_embed(diagonal)
        below = torch.tril_indices(size, size, -1, device=raw.device)
        factor[..., below[0], below[1]] = diagonal[..., below[0]] * raw[..., size:]
        return factor

    def _base_controls(self, motion: Motion, start: Trend) -> Float[Tensor, "R K T m"]:
        """Controls of the fading CTRA, which never brakes below standstill."""
        speed = motion.velocity[..., 0]
        forward = start.velocity / safe_norm(start.velocity).unsqueeze(-1)
        along = (start.acceleration * forward).sum(-1)
        across = (
            forward[..., 0] * start.acceleration[..., 1]
            - forward[..., 1] * start.acceleration[..., 0]
        )
        slowest = -speed / FADE_S
        acceleration = torch.maximum(along.clamp(-3.0, 3.0), slowest)
        curvature = (across / (speed.square() + 0.25)).clamp(-1.0, 1.0)
        steps = torch.arange(self.horizon_steps, dtype=speed.dtype, device=speed.device)
        fading = torch.exp(-self.dynamics.dt_s * (steps + 0.5) / FADE_S)
        state = self.dynamics.state_on_course(motion).unsqueeze(-2)
        return self.dynamics.control_for(
            state.expand(*speed.shape, self.horizon_steps, -1),
            acceleration.unsqueeze(-1) * fading,
            curvature.unsqueeze(-1) * fading,
        )


def present_motion(start: Trend, rows: AgentBatch) -> Motion:
    """Motion `R K` now in the own frames, on the course of the velocity of each component."""
    speed = safe_norm(start.velocity)
    track = rows.past.motion.heading[:, -1:].expand_as(speed)
    heading = current_course(start.velocity, track)
    zero = torch.zeros_like(speed)
    return Motion(start.offset, heading, torch.stack([speed, zero], -1), zero)
