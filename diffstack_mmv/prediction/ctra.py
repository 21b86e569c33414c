"""Constant turn rate and acceleration."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.geometry import left_of, rotate
from diffstack_mmv.prediction.baselines import Extrapolation, Spread
from diffstack_mmv.prediction.current import current_position, trend
from diffstack_mmv.smooth import safe_norm
from diffstack_mmv.types import Tracks


class ConstantTurnRateAcceleration(Extrapolation):
    """CTRA: acceleration a₀ and yaw rate ω₀ of the recent track persist, fading out exponentially.

        v(t) = max(v₀ + a₀ τ (1 - exp(-t / τ)), 0),    θ(t) = θ₀ + ω₀ τ (1 - exp(-t / τ))

    integrated by the midpoint rule, with the course θ₀. A large τ gives the textbook model, whose
    errors on measured tracks exceed those of constant velocity: an acceleration of a cyclist rarely
    lasts for three seconds.

    Args:
        horizon_steps: Number of predicted time steps T.
        dt_s: Length of one step in s.
        spread: How the uncertainty grows.
        memory_s: Memory of the fit of velocity and acceleration to the track, see `trend`.
        acceleration_fade_s: τ of the acceleration.
        yaw_rate_fade_s: τ of the yaw rate.
        acceleration_limit_mps2: Bound on |a₀|.
        yaw_rate_limit_radps: Bound on |ω₀|.
        walking_mps: Speed below which the turn counts less, as the course is not observable at
            rest.

    Raises:
        ValueError: A time, limit or speed is not positive.
    """

    def __init__(
        self,
        horizon_steps: int = 30,
        dt_s: float = 0.1,
        spread: Spread | None = None,
        memory_s: float = 0.7,
        acceleration_fade_s: float = 0.3,
        yaw_rate_fade_s: float = 0.3,
        acceleration_limit_mps2: float = 3.0,
        yaw_rate_limit_radps: float = 1.0,
        walking_mps: float = 0.5,
    ) -> None:
        super().__init__(horizon_steps, dt_s, spread)
        self.memory_s = memory_s
        self.acceleration_fade_s = acceleration_fade_s
        self.yaw_rate_fade_s = yaw_rate_fade_s
        self.acceleration_limit_mps2 = acceleration_limit_mps2
        self.yaw_rate_limit_radps = yaw_rate_limit_radps
        self.walking_mps = walking_mps
        for name in ("memory_s", "acceleration_fade_s", "yaw_rate_fade_s", "walking_mps"):
            require_positive(name, getattr(self, name))
        require_positive("acceleration_limit_mps2", acceleration_limit_mps2)
        require_positive("yaw_rate_limit_radps", yaw_rate_limit_radps)

    def positions(self, tracks: Tracks, time: Float[Tensor, " T"]) -> Float[Tensor, "*b T 2"]:
        """Positions in m of agents `*b` at times in s after their last row."""
        now = trend(tracks, self.memory_s, self.dt_s)
        speed = safe_norm(now.velocity)
        forward = now.velocity / speed.unsqueeze(-1)
        left = left_of(forward)
        acceleration = (now.acceleration * forward).sum(-1)
        yaw_rate = (
            (now.acceleration * left).sum(-1) * speed / (speed.square() + self.walking_mps**2)
        )
        middle = time - 0.5 * self.dt_s
        acceleration = acceleration.clamp(
            -self.acceleration_limit_mps2, self.acceleration_limit_mps2
        )
        yaw_rate = yaw_rate.clamp(-self.yaw_rate_limit_radps, self.yaw_rate_limit_radps)
        gained = acceleration.unsqueeze(-1) * faded(middle, self.acceleration_fade_s)
        turned = yaw_rate.unsqueeze(-1) * faded(middle, self.yaw_rate_fade_s)
        way = self.dt_s * (speed.unsqueeze(-1) + gained).clamp_min(0)
        step = way.unsqueeze(-1) * rotate(forward.unsqueeze(-2), turned)
        # a product, since running sums of real numbers are not deterministic on a GPU
        so_far = torch.ones(len(time), len(time), dtype=step.dtype, device=step.device).tril()
        return current_position(tracks).unsqueeze(-2) + so_far @ step


def faded(time: Float[Tensor, " T"], fade_s: float) -> Float[Tensor, " T"]:
    """Integral τ (1 - exp(-t / τ)) in s of a rate that fades with the time constant `fade_s`."""
    return -fade_s * torch.expm1(-time / fade_s)
