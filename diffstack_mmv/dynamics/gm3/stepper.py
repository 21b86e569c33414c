"""Time stepping: LIM2 for use, explicit methods for comparison.

The lateral and yaw rates of a light vehicle are fast, 50 to 1300 1/s, while its path is slow:
explicit Euler at 0.1 s is unstable for every single-track vehicle between 0 and 10 m/s.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.gm3.body import LinearEquation, factored, times
from diffstack_mmv.dynamics.gm3.lean import Lean, lean_after
from diffstack_mmv.dynamics.gm3.zero_order_hold import ZeroOrderHoldDynamics, unpack


@runtime_checkable
class Stepper(Protocol):
    """One step of a numerical method."""

    def __call__(
        self, dynamics: ZeroOrderHoldDynamics, state: Float[Tensor, "8 n"], step_s: float
    ) -> Float[Tensor, "8 n"]:
        """State after `step_s` seconds."""
        ...


class ExplicitEuler:
    """x⁺ = x + h f(x), as printed in DMMV; for comparison only."""

    def __call__(
        self, dynamics: ZeroOrderHoldDynamics, state: Float[Tensor, "8 n"], step_s: float
    ) -> Float[Tensor, "8 n"]:
        """State after one step."""
        return state + step_s * dynamics.derivative(state)


class RungeKutta4:
    """The classical method of fourth order; needs substeps of 1 to 5 ms."""

    def __call__(
        self, dynamics: ZeroOrderHoldDynamics, state: Float[Tensor, "8 n"], step_s: float
    ) -> Float[Tensor, "8 n"]:
        """State after one step."""
        first = dynamics.derivative(state)
        second = dynamics.derivative(state + 0.5 * step_s * first)
        third = dynamics.derivative(state + 0.5 * step_s * second)
        fourth = dynamics.derivative(state + step_s * third)
        return state + step_s / 6 * (first + 2 * (second + third) + fourth)


class VelocityStep(NamedTuple):
    """Velocity (v_x, v_y, r) after a step, and its mean over the step."""

    end: Float[Tensor, "3 n"]
    mean: Float[Tensor, "3 n"]


def pade_step(
    equation: LinearEquation, velocity: Float[Tensor, "3 n"], step_s: float, parts: int = 1
) -> VelocityStep:
    """L-stable step of second order (Padé 0,2) of v' = A v + b with A and b constant.

    With W = I - hA + (hA)²/2 and f = A v + b the change is h W⁻¹ (f - (h/2) A f), the mean
    v + (h/2) W⁻¹ (f - h A f); written as changes, which single precision needs at standstill,
    where hA is large. `parts` of the step are taken one after the other with the same W. Rates
    beyond what the precision resolves, which only the printed tyre law reaches, with a wheel in the
    air, are slowed down to it; their equilibrium stays.
    """
    part_s = step_s / parts
    matrix = equation.matrix
    fastest = torch.finfo(matrix.dtype).eps ** -0.4 / part_s
    excess = (matrix.square().sum((0, 1)) / fastest**2).clamp_min(1)
    pace = part_s * excess.rsqrt()
    scaled = pace * matrix
    square = (scaled.unsqueeze(2) * scaled.unsqueeze(0)).sum(1)
    identity = torch.eye(3, dtype=matrix.dtype, device=matrix.device).unsqueeze(-1)
    system = factored(identity - scaled + 0.5 * square)
    end, means = velocity, []
    for _ in range(parts):
        half = 0.5 * pace * system.solve(equation.rate(end))
        means.append(end + (half - times(scaled, half)))
        end = means[-1] + half
    return VelocityStep(end, means[0] if parts == 1 else sum(means[1:], means[0]) / parts)


class LIM2:
    """Linearly implicit midpoint rule with frozen secant coefficients.

    A and b of the velocity equation are frozen at the middle of the step, which is found in two
    rounds: the end of half a step with A and b at the start, then the mean of a whole step with
    those found there. The second round looks at the slips only, under the loads of the first: a
    jump of the steering saturates the tyres for a moment, and the coefficients of that moment point
    the gradient elsewhere. The velocity then takes two half steps; the pose uses its mean, the lean
    a trapezoid. L-stable, second order: loads and traction are those of the middle, too.
    """

    def __call__(
        self, dynamics: ZeroOrderHoldDynamics, state: Float[Tensor, "8 n"], step_s: float
    ) -> Float[Tensor, "8 n"]:
        """State after one step."""
        position, velocity, heading, lean = unpack(state)
        start = dynamics.equation(velocity, dynamics.contact(velocity, lean.angle))
        half = pade_step(start, velocity, 0.5 * step_s)
        midway = self._lean(dynamics, lean, lean.angle, velocity, half, 0.5 * step_s)
        first = dynamics.contact(half.end, midway.angle)
        middle = pade_step(dynamics.equation(half.end, first), velocity, step_s, parts=2).mean
        second = dynamics.equation(middle, dynamics.slipping(middle, first.grip))
        full = pade_step(second, velocity, step_s, parts=2)
        end = self._lean(dynamics, lean, midway.angle, velocity, full, step_s)
        forward, left, yaw_rate = full.mean.unbind(0)
        mean_heading = heading + 0.5 * step_s * yaw_rate
        cosine, sine = mean_heading.cos(), mean_heading.sin()
        moved = torch.stack([cosine * forward - sine * left, sine * forward + cosine * left])
        position = position + step_s * moved
        turned = heading + step_s * yaw_rate
        rates = full.end.unbind(0)
        return torch.stack([*position.unbind(0), *rates[:2], turned, rates[2], *end])

    @staticmethod
    def _lean(
        dynamics: ZeroOrderHoldDynamics,
        lean: Lean,
        frozen: Float[Tensor, " n"],
        before: Float[Tensor, "3 n"],
        velocity: VelocityStep,
        step_s: float,
    ) -> Lean:
        """Lean after a step, with its coefficients frozen at some angle."""
        if not dynamics.leans:
            return lean
        coefficients = dynamics.lean_coefficients(frozen)
        change = (velocity.end[0] * velocity.end[2] - before[0] * before[2]) / step_s
        lateral = dynamics.anticipated(velocity.mean[0] * velocity.mean[2], change)
        return lean_after(lean, lateral, coefficients, step_s)
