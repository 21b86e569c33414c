"""Lean of a single-track vehicle, and the camber that its tyres feel.

I_x γ'' = m h a_y cos γ - m g h sin γ - d_roll γ' with a_y = v_x r: a stable pendulum whose steady
lean is atan(a_y / g), a surrogate for the balancing rider. The state is never clamped; the clamp
acts on the camber only. Source: DMMV, Sec. IV-B, with I_x about the line on the ground.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.smooth import sinc, soft_clamp
from diffstack_mmv.types import GRAVITY


class Lean(NamedTuple):
    """Lean γ in rad, positive to the left, and its rate in rad/s."""

    angle: Float[Tensor, " n"]
    rate: Float[Tensor, " n"]


class LeanCoefficients(NamedTuple):
    """γ'' = push · a_y - restore · γ - damp · γ', frozen at some lean."""

    push: Float[Tensor, " n"]  # 1/m
    restore: Float[Tensor, " n"]  # 1/s^2
    damp: Float[Tensor, "..."]  # 1/s


class RollBody(NamedTuple):
    """What a pendulum is made of."""

    mass_height: float  # m h in kg m
    inertia: Float[Tensor, ""]  # I_x in kg m^2
    damping: Float[Tensor, ""]  # d_roll in N m s


class Pendulum(NamedTuple):
    """γ'' = push · a_y cos γ - restore · sin γ - damp · γ'."""

    push: Float[Tensor, ""] | float  # 1/m
    restore: Float[Tensor, ""] | float  # 1/s^2
    damp: Float[Tensor, ""]  # 1/s

    def secant(self, lean: Float[Tensor, " n"]) -> LeanCoefficients:
        """Coefficients of the equation that is linear in γ and agrees with this one at a lean."""
        return LeanCoefficients(self.push * lean.cos(), self.restore * sinc(lean), self.damp)


@runtime_checkable
class LeanLaw(Protocol):
    """How a leaning vehicle follows its lateral acceleration."""

    @property
    def lead_s(self) -> float:
        """By how much the lateral acceleration is taken ahead of its time, to first order."""
        ...

    def pendulum(self, body: RollBody) -> Pendulum:
        """Equation of the lean for a body."""
        ...


@dataclass(frozen=True)
class PrescribedLean:
    """The pendulum of DMMV: it follows the turn, by roll_damping / (m g h) seconds late."""

    @property
    def lead_s(self) -> float:
        """None: nothing anticipates the turn."""
        return 0.0

    def pendulum(self, body: RollBody) -> Pendulum:
        """The body's own."""
        per_inertia = body.mass_height / body.inertia
        return Pendulum(per_inertia, per_inertia * GRAVITY, body.damping / body.inertia)


@dataclass(frozen=True)
class CoordinatedLean:
    """Lean of a steady turn, tan γ = a_y / g, taken `anticipation_s` before the turn.

    A rider, or the controller of a bicycle without one, leans first and lets the turn follow. With
    T = anticipation + 2 / ω the critically damped equation

        γ'' = ω² (cos γ (a_y + T a_y') / g - sin γ) - 2 ω γ'

    leads the steady lean by the anticipation at low frequencies, and is deaf to those beyond ω. It
    takes the place of roll inertia and roll damping.

    Attributes:
        anticipation_s: By how much the lean comes before the lateral acceleration.
        bandwidth_radps: ω.

    Raises:
        ValueError: The bandwidth is not positive.
    """

    anticipation_s: float = 0.1
    bandwidth_radps: float = 8.0

    def __post_init__(self) -> None:
        require_positive("bandwidth_radps", self.bandwidth_radps)

    @property
    def lead_s(self) -> float:
        """T."""
        return self.anticipation_s + 2.0 / self.bandwidth_radps

    def pendulum(self, body: RollBody) -> Pendulum:
        """One that depends on neither mass nor damping."""
        stiffness = self.bandwidth_radps**2
        damp = torch.full_like(body.damping, 2.0 * self.bandwidth_radps)
        return Pendulum(stiffness / GRAVITY, stiffness, damp)


def lean_acceleration(
    lean: Lean, lateral: Float[Tensor, " n"], coefficients: LeanCoefficients
) -> Float[Tensor, " n"]:
    """γ'' in rad/s² for a lateral acceleration in m/s²."""
    push, restore, damp = coefficients
    return push * lateral - restore * lean.angle - damp * lean.rate


def lean_after(
    lean: Lean, lateral: Float[Tensor, " n"], coefficients: LeanCoefficients, step_s: float
) -> Lean:
    """Trapezoidal step of the frozen equation over `step_s`."""
    push, restore, damp = coefficients
    half = 0.5 * step_s
    pushed = lean.rate + half * (push * lateral - restore * lean.angle)
    mean_rate = pushed / (1 + half * damp + half**2 * restore)
    return Lean(lean.angle + step_s * mean_rate, 2 * mean_rate - lean.rate)


def camber_spin(
    lean: Float[Tensor, " n"], limit_rad: float, per_radius: Float[Tensor, "wheels 1"]
) -> Float[Tensor, "wheels n"]:
    """(1 - ε_γ) sin(γ_c) / R in 1/m, γ_c the softly clamped lean, `per_radius` (1 - ε_γ) / R."""
    return per_radius * soft_clamp(lean, limit_rad).sin()
