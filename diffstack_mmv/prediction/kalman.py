"""Constant velocity with a Kalman filter on the measured positions."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.geometry import scale_from_covariance, times_ahead
from diffstack_mmv.prediction.base import Predictor, all_agents
from diffstack_mmv.prediction.baselines import single_component
from diffstack_mmv.prediction.current import current_heading
from diffstack_mmv.prediction.gaussian import covariance_along
from diffstack_mmv.types import Forecast, Tracks


class KalmanConstantVelocity(Predictor):
    """Filters position and velocity x = (p, v) of every agent and extrapolates mean and covariance.

    Process: p⁺ = p + v dt, v⁺ = v + w with white acceleration of spectral density q per axis.
    Measurement: the position with errors along and across the heading. The filter starts at the
    first valid row and skips rows that are not valid.

    Args:
        horizon_steps: Number of predicted time steps T.
        dt_s: Length of one step in s.
        along_m: Standard deviation of a measured position along the heading.
        across_m: Standard deviation across it.
        acceleration_density: q in m²/s³.
        speed_mps: Standard deviation of the velocity before the first measurement.

    Raises:
        ValueError: A deviation or density is not positive.
    """

    def __init__(
        self,
        horizon_steps: int = 30,
        dt_s: float = 0.1,
        along_m: float = 0.08,
        across_m: float = 0.05,
        acceleration_density: float = 0.1,
        speed_mps: float = 3.0,
    ) -> None:
        super().__init__(horizon_steps, dt_s)
        numbers = {"along_m": along_m, "across_m": across_m, "speed_mps": speed_mps}
        for name, number in (numbers | {"acceleration_density": acceleration_density}).items():
            require_positive(name, number)
        self.along_m, self.across_m = along_m, across_m
        self.acceleration_density, self.speed_mps = acceleration_density, speed_mps

    def forward(self, past: Tracks, neighbors: Tracks) -> Forecast:
        """Forecast all agents, `*b 1+N`."""
        tracks = all_agents(past, neighbors)
        state, covariance = self.filtered(tracks)
        time = times_ahead(state, self.horizon_steps, self.dt_s)
        column = time[:, None, None]
        position, velocity = state[..., None, :2], state[..., None, 2:]
        blocks = covariance.unsqueeze(-3)
        drift = (
            column * (blocks[..., :2, 2:] + blocks[..., 2:, :2]) + column**2 * blocks[..., 2:, 2:]
        )
        noise = (
            self.acceleration_density
            / 3
            * column**3
            * torch.eye(2, device=time.device, dtype=time.dtype)
        )
        return single_component(
            position + time.unsqueeze(-1) * velocity,
            scale_from_covariance(blocks[..., :2, :2] + drift + noise),
        )

    def filtered(self, tracks: Tracks) -> tuple[Float[Tensor, "*b 4"], Float[Tensor, "*b 4 4"]]:
        """Mean (m, m/s) and covariance of position and velocity at the last row, given all rows."""
        valid = tracks.valid
        measured = torch.where(valid.unsqueeze(-1), tracks.motion.position, 0.0)
        heading = torch.where(valid, tracks.motion.heading, current_heading(tracks).unsqueeze(-1))
        size = torch.ones_like(heading)
        noise = covariance_along(heading, self.along_m * size, self.across_m * size)
        state = torch.cat([measured[..., 0, :], torch.zeros_like(measured[..., 0, :])], -1)
        covariance = self._start(noise[..., 0, :, :])
        started = valid[..., 0]
        for row in range(1, valid.shape[-1]):
            state, covariance = self._predicted(state, covariance)
            fresh = torch.cat([measured[..., row, :], torch.zeros_like(measured[..., row, :])], -1)
            updated = _updated(state, covariance, measured[..., row, :], noise[..., row, :, :])
            state = _choose(valid[..., row] & started, updated[0], state, fresh, started)
            covariance = _choose(
                valid[..., row] & started,
                updated[1],
                covariance,
                self._start(noise[..., row, :, :]),
                started,
            )
            started = started | valid[..., row]
        return state, covariance

    def _start(self, noise: Float[Tensor, "*b 2 2"]) -> Float[Tensor, "*b 4 4"]:
        """Covariance after the first measurement, of a velocity that is not yet known."""
        velocity = self.speed_mps**2 * torch.eye(
            2, device=noise.device, dtype=noise.dtype
        ).expand_as(noise)
        none = torch.zeros_like(noise)
        return torch.cat([torch.cat([noise, none], -1), torch.cat([none, velocity], -1)], -2)

    def _predicted(
        self, state: Float[Tensor, "*b 4"], covariance: Float[Tensor, "*b 4 4"]
    ) -> tuple[Float[Tensor, "*b 4"], Float[Tensor, "*b 4 4"]]:
        dt_s = self.dt_s
        identity = torch.eye(2, device=state.device, dtype=state.dtype)
        none = torch.zeros_like(identity)
        transition = torch.cat(
            [torch.cat([identity, dt_s * identity], -1), torch.cat([none, identity], -1)], -2
        )
        entries = dt_s**3 / 3, dt_s**2 / 2, dt_s**2 / 2, dt_s
        growth = torch.cat([state.new_full((1,), entry) for entry in entries]).unflatten(0, (2, 2))
        noise = self.acceleration_density * torch.kron(growth, identity)
        moved = (transition @ state.unsqueeze(-1)).squeeze(-1)
        return moved, transition @ covariance @ transition.mT + noise


def _updated(
    state: Float[Tensor, "*b 4"],
    covariance: Float[Tensor, "*b 4 4"],
    measured: Float[Tensor, "*b 2"],
    noise: Float[Tensor, "*b 2 2"],
) -> tuple[Float[Tensor, "*b 4"], Float[Tensor, "*b 4 4"]]:
    """State and covariance after a measurement, in Joseph's form, which stays positive."""
    innovation = covariance[..., :2, :2] + noise
    determinant = (
        innovation[..., 0, 0] * innovation[..., 1, 1]
        - innovation[..., 0, 1] * innovation[..., 1, 0]
    )
    sign = 2 * torch.eye(2, device=state.device, dtype=state.dtype) - 1
    adjugate = innovation.flip((-2, -1)) * sign
    gain = covariance[..., :2] @ (adjugate.mT / determinant[..., None, None])
    corrected = state + (gain @ (measured - state[..., :2]).unsqueeze(-1)).squeeze(-1)
    rest = torch.eye(4, device=state.device, dtype=state.dtype) - torch.cat(
        [gain, torch.zeros_like(gain)], -1
    )
    return corrected, rest @ covariance @ rest.mT + gain @ noise @ gain.mT


def _choose(
    measured: Bool[Tensor, "*b"],
    updated: Tensor,
    predicted: Tensor,
    fresh: Tensor,
    started: Bool[Tensor, "*b"],
) -> Tensor:
    """The update at a measurement, else the prediction, and a fresh start before the first."""
    extra = (None,) * (updated.dim() - measured.dim())
    known = torch.where(measured[(..., *extra)], updated, predicted)
    return torch.where(started[(..., *extra)], known, fresh)
