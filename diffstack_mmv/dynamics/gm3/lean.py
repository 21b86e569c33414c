"""Lean of a single-track vehicle, and the camber that its tyres feel.

I_x γ'' = m h a_y cos γ - m g h sin γ - d_roll γ' with a_y = v_x r: a stable pendulum whose steady
lean is atan(a_y / g), a surrogate for the balancing rider. The state is never clamped; the clamp
acts on the camber only. Source: DMMV, Sec. IV-B, with I_x about the line on the ground.
"""

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.gm3.load import GRAVITY
from diffstack_mmv.smooth import sinc, soft_clamp


class Lean(NamedTuple):
    """Lean γ in rad, positive to the left, and its rate in rad/s."""

    angle: Float[Tensor, " n"]
    rate: Float[Tensor, " n"]


class LeanCoefficients(NamedTuple):
    """γ'' = push · a_y - restore · γ - damp · γ', frozen at some lean."""

    push: Float[Tensor, " n"]  # 1/m
    restore: Float[Tensor, " n"]  # 1/s^2
    damp: Float[Tensor, "..."]  # 1/s


def lean_coefficients(
    lean: Float[Tensor, " n"],
    mass_height: float,
    roll_inertia: Float[Tensor, ""],
    roll_damping: Float[Tensor, ""],
) -> LeanCoefficients:
    """Secant coefficients at a lean in rad; `mass_height` is m h in kg m."""
    per_inertia = mass_height / roll_inertia
    return LeanCoefficients(
        per_inertia * lean.cos(), per_inertia * GRAVITY * sinc(lean), roll_damping / roll_inertia
    )


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
