"""A plain sampling MPC (MPPI), the baseline that a gradient has to beat."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.dynamics import DynamicsModel, rollout
from diffstack_mmv.planning import with_final_row
from diffstack_mmv.simulation.people import PeopleForecast
from diffstack_mmv.simulation.safety import clearance_of
from diffstack_mmv.simulation.world import Observation
from diffstack_mmv.types import Motion, map_tensors

COLLISION_COST = 1e3
LACK_COST = 50.0  # per metre of missing clearance and step
EXCESS_COST = 20.0  # per (m/s)² above the cruising speed


class MPPIController:
    """Model predictive path integral control: controls averaged with weights exp(-cost / λ).

    u ← Σ_k w_k u_k, u_k ~ N(u, σ²) in the box, w = softmax(-S / λ), S = Σ_t ‖p_t - g‖ up to the
    arrival, plus prices of collision, lack of clearance and excess of speed. The mean is shifted by
    one step between decisions.

    Args:
        dynamics: Model of the vehicle, whose step is the time between two decisions.
        people: Forecast of the humans.
        cruise_mps: Speed that costs nothing.
        steps: Horizon in steps of the model.
        samples: Number of sampled plans per episode.
        temperature: λ.
        deviation: σ as a share of each control's range.
        margin_m: Clearance below which a plan is penalised.
        seed: Of the samples.
        actuate: Turns controls of the model into those of the robot.

    Raises:
        ValueError: A number is not positive.

    Source:
        Williams et al., Information theoretic MPC for model-based reinforcement learning (2017).
    """

    def __init__(
        self,
        dynamics: DynamicsModel,
        people: PeopleForecast,
        cruise_mps: float = 3.0,
        steps: int = 12,
        samples: int = 256,
        temperature: float = 0.5,
        deviation: float = 0.25,
        margin_m: float = 0.3,
        seed: int = 0,
        actuate: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        require_at_least("steps", steps, 1)
        require_at_least("samples", samples, 2)
        for name, value in (
            ("cruise_mps", cruise_mps),
            ("temperature", temperature),
            ("deviation", deviation),
        ):
            require_positive(name, value)
        self.dynamics = dynamics
        self.people = people
        self.cruise_mps, self.steps, self.samples = cruise_mps, steps, samples
        self.temperature, self.deviation, self.margin_m = temperature, deviation, margin_m
        self.seed = seed
        self.actuate = actuate
        self._mean = torch.zeros(0, steps, dynamics.control_dim)
        self._generator = torch.Generator()

    @torch.no_grad()
    def __call__(self, observation: Observation) -> Float[Tensor, "*b m"]:
        """First control of the averaged plan, SI units."""
        if observation.time.dim() == 0:
            return self(map_tensors(lambda field: field.unsqueeze(0), observation)).squeeze(0)
        self._prepare(observation)
        rows = observation.running.nonzero().squeeze(-1)
        seen = map_tensors(lambda field: field[rows], observation)
        lower, upper = self.dynamics.bounds
        noise = torch.randn(
            len(rows), self.samples, *self._mean.shape[1:], generator=self._generator
        ).to(self._mean)
        noise[:, 0] = 0
        mean = self._mean[rows]
        plans = self.dynamics.within_bounds(
            mean.unsqueeze(1) + self.deviation * (upper - lower) * noise
        )
        people = self.people(observation, self.dynamics.dt_s, self.steps)[rows].to(self._mean)
        weight = torch.softmax(-self._cost(seen, plans, people) / self.temperature, -1)
        self._mean[rows] = (weight[..., None, None] * plans).sum(1)
        action = self._mean[:, 0]
        return action if self.actuate is None else self.actuate(action)

    def _prepare(self, observation: Observation) -> None:
        """Shift the mean by one step, or begin anew at the start of episodes."""
        count = observation.time.shape[0]
        if bool((observation.time == 0).any()) or len(self._mean) != count:
            lower = self.dynamics.bounds.lower
            self._mean = torch.zeros(count, self.steps, len(lower)).to(lower)
            self._generator.manual_seed(self.seed)
        else:
            self._mean = torch.cat([self._mean[:, 1:], self._mean[:, -1:]], 1)

    def _cost(
        self,
        seen: Observation,
        plans: Float[Tensor, "r K T m"],
        people: Float[Tensor, "r h T1 2"],
    ) -> Float[Tensor, "r K"]:
        """Price of every sampled plan."""
        start = self.dynamics.initial_state(
            Motion(*(field.to(self._mean) for field in seen.motion))
        )
        states = rollout(self.dynamics, start.unsqueeze(1).expand(-1, self.samples, -1), plans)
        motion = self.dynamics.motion(states, with_final_row(plans))
        reach = (seen.radius[:, None] + seen.human_radius).to(self._mean)
        clearance = clearance_of(motion.position, people, reach).amin(2)
        distance = (motion.position - seen.goal[:, None, None].to(self._mean)).norm(dim=-1)
        arrived = (distance[..., 1:] < 0.25).long()
        under_way = (arrived.cumsum(-1) - arrived) == 0
        excess = (motion.velocity[..., 1:, 0] - self.cruise_mps).clamp_min(0)
        price = distance[..., 1:] + EXCESS_COST * excess.square()
        price = price + LACK_COST * (self.margin_m - clearance).clamp_min(0)
        price = price + COLLISION_COST * (clearance < 0)
        return (price * under_way).sum(-1)
