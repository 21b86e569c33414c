"""A plain sampling MPC (MPPI), the baseline that a gradient has to beat."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.dynamics import DynamicsModel, rollout
from diffstack_mmv.planning import (
    clearance_within_steps,
    predicted_obstacles,
)
from diffstack_mmv.simulation.case_noise import NoiseSource, case_noise, milliseconds
from diffstack_mmv.simulation.decisions import Decided, batched, continued, unbatched
from diffstack_mmv.simulation.forecasters import PedestrianForecaster
from diffstack_mmv.simulation.observation import Observation, in_precision_of
from diffstack_mmv.types import Forecast, map_tensors

COLLISION_COST = 1e3
LACK_COST = 50.0  # per metre of missing clearance and step
EXCESS_COST = 20.0  # per (m/s)² above the cruising speed


class MPPIState(NamedTuple):
    """What the controller knows from the decisions before, for `b` episodes."""

    forecaster: Any  # the record of the forecaster
    mean: Float[Tensor, "b T m"]  # the averaged plans, from the next decision on


@dataclass(frozen=True)
class MPPIController:
    """Model predictive path integral control: controls averaged with weights exp(-cost / λ).

    u ← Σ_k w_k u_k, u_k ~ N(u, σ²) in the box, w = softmax(-S / λ), S = Σ_t ‖p_t - g‖ up to the
    arrival, plus prices of collision, lack of clearance and excess of speed. The mean is shifted by
    the time between decisions.

    Attributes:
        dynamics: Model of the vehicle.
        forecaster: Predicts the pedestrians.
        cruise_mps: Speed that costs nothing.
        steps: Horizon in steps of the model.
        samples: Number of sampled plans per episode.
        temperature: λ.
        deviation: σ as a share of each control's range.
        margin_m: Clearance below which a plan is penalised.
        seed: Of the samples.
        actuate: Turns controls of the model into those of the robot.
        decision_s: Time between two decisions; by default the step of the model.

    Raises:
        ValueError: A number is not positive.

    Source:
        Williams et al., Information theoretic MPC for model-based reinforcement learning (2017).
    """

    dynamics: DynamicsModel
    forecaster: PedestrianForecaster
    cruise_mps: float = 3.0
    steps: int = 12
    samples: int = 256
    temperature: float = 0.5
    deviation: float = 0.25
    margin_m: float = 0.3
    seed: int = 0
    actuate: Callable[[Tensor], Tensor] | None = None
    decision_s: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_at_least("steps", self.steps, 1)
        require_at_least("samples", self.samples, 2)
        for name in ("cruise_mps", "temperature", "deviation"):
            require_positive(name, getattr(self, name))
        if self.decision_s is not None:
            require_positive("decision_s", self.decision_s)

    def init(self, observation: Observation) -> MPPIState:
        """State at the start of episodes: zero controls, and the samples from their beginning."""
        observation, like = batched(observation), self.dynamics.bounds.lower
        mean = like.new_zeros(len(observation.time), self.steps, len(like))
        return MPPIState(self.forecaster.init(observation), mean)

    @torch.no_grad()
    def act(self, state: MPPIState, observation: Observation) -> Decided:
        """First control of the averaged plan, in the units of the robot."""
        if observation.time.dim() == 0:
            return unbatched(self, state, observation)
        told = self.forecaster(state.forecaster, observation, self.dynamics.dt_s, self.steps)
        rows = observation.running.nonzero().squeeze(-1)
        mean, moment = state.mean[rows], milliseconds(observation.time[rows])
        shape = (self.samples, *mean.shape[1:])
        cases = observation.case[rows]
        noise = case_noise(NoiseSource.PLANS, cases, moment, shape, self.seed).to(mean)
        noise[:, 0] = 0
        lower, upper = self.dynamics.bounds
        plans = self.dynamics.within_bounds(
            mean.unsqueeze(1) + self.deviation * (upper - lower) * noise
        )
        seen, forecast = map_tensors(lambda entry: entry[rows], (observation, told.forecast))
        weight = torch.softmax(-self._cost(seen, plans, forecast) / self.temperature, -1)
        averaged = state.mean.index_copy(0, rows, (weight[..., None, None] * plans).sum(1))
        action = averaged[:, 0]
        passed = 1.0 if self.decision_s is None else self.decision_s / self.dynamics.dt_s
        after = MPPIState(told.state, continued(averaged, passed))
        return Decided(action if self.actuate is None else self.actuate(action), after)

    def _cost(
        self, seen: Observation, plans: Float[Tensor, "r K T m"], forecast: Forecast
    ) -> Float[Tensor, "r K"]:
        """Price of every sampled plan, lack of clearance and collision in expectation."""
        seen, forecast = in_precision_of(plans, (seen, forecast))
        start = self.dynamics.initial_state(seen.motion)
        states = rollout(self.dynamics, start.unsqueeze(1).expand(-1, self.samples, -1), plans)
        motion = self.dynamics.motion(states, torch.nn.functional.pad(plans, (0, 0, 0, 1)))
        obstacles = predicted_obstacles(
            seen.pedestrian_position, seen.pedestrian_radius, seen.seen, forecast
        )
        clearance = clearance_within_steps(motion, seen.discs, obstacles)
        likely = obstacles.weight[:, None, :, :, None]

        def expected(component: Tensor) -> Tensor:
            each = (likely * component).sum(3)
            return each.amax(2) if each.shape[2] else each.sum(2)

        distance = (motion.position - seen.goal[:, None, None]).norm(dim=-1)
        arrived = (distance[..., 1:] < 0.25).long()
        under_way = (arrived.cumsum(-1) - arrived) == 0
        excess = (motion.velocity[..., 1:, 0] - self.cruise_mps).clamp_min(0)
        price = distance[..., 1:] + EXCESS_COST * excess.square()
        price = price + LACK_COST * expected((self.margin_m - clearance).clamp_min(0))
        price = price + COLLISION_COST * expected((clearance < 0).to(clearance))
        return (price * under_way).sum(-1)
