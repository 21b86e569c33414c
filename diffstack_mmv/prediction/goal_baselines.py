"""Trajectories to a known goal: what a plan with a given goal has to beat."""

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.geometry import rotate, shares_ahead
from diffstack_mmv.types import Motion


def straight_line(
    motion: Motion, goal: Float[Tensor, "*b 2"], steps: int, dt_s: float
) -> Float[Tensor, "*b steps 2"]:
    """Positions in m on the line to the goal: p(s) = p₀ + s (g - p₀), s = t / T."""
    share = shares_ahead(motion.position, steps).unsqueeze(-1)
    return motion.position.unsqueeze(-2) + share * (goal - motion.position).unsqueeze(-2)


def constant_acceleration(
    motion: Motion, goal: Float[Tensor, "*b 2"], steps: int, dt_s: float
) -> Float[Tensor, "*b steps 2"]:
    """Positions in m at the constant acceleration that leads to the goal.

    p(s) = p₀ + s v₀ T + s² (g - p₀ - v₀ T), s = t / T.
    """
    share = shares_ahead(motion.position, steps).unsqueeze(-1)
    coast = _coast(motion, steps, dt_s)
    rest = goal - motion.position - coast
    return (
        motion.position.unsqueeze(-2) + share * coast.unsqueeze(-2) + share**2 * rest.unsqueeze(-2)
    )


def hermite_spline(
    motion: Motion, goal: Float[Tensor, "*b 2"], steps: int, dt_s: float
) -> Float[Tensor, "*b steps 2"]:
    """Positions in m on the cubic Hermite spline to the goal.

    p(s) = h₀₀ p₀ + h₁₀ T v₀ + h₀₁ g + h₁₁ T v₁. The velocity at the goal is not known; the natural
    end, without acceleration at the goal, gives v₁ = (3 (g - p₀) / T - v₀) / 2.
    """
    share = shares_ahead(motion.position, steps).unsqueeze(-1)
    coast = _coast(motion, steps, dt_s)
    way = goal - motion.position
    end = 0.5 * (3 * way - coast)
    start_weight = share * (1 - share) ** 2
    goal_weight = share**2 * (3 - 2 * share)
    end_weight = share**2 * (share - 1)
    return (
        motion.position.unsqueeze(-2)
        + start_weight * coast.unsqueeze(-2)
        + goal_weight * way.unsqueeze(-2)
        + end_weight * end.unsqueeze(-2)
    )


def _coast(motion: Motion, steps: int, dt_s: float) -> Float[Tensor, "*b 2"]:
    """Way in m over the whole horizon at the present velocity."""
    return steps * dt_s * rotate(motion.velocity, motion.heading)
