"""The interface of a predictor, and views on what it returns.

A predictor answers for the ego and all neighbors in one forecast: the dimension after the batch is
the agent, 0 is the ego and 1 .. N are the neighbors in the order in which they were given.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from diffstack_mmv.checks import require, require_at_least, require_positive, require_whole
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.types import Forecast, Motion, StackBatch, Tracks, map_tensors, taken

GaussianRollout = Callable[
    [DynamicsModel, Tensor, Tensor, Tensor, Tensor], tuple[Tensor, Tensor] | None
]
"""(dynamics, first state `N n`, its covariance `N n n`, controls `N T m`, Cholesky factors of their
covariances `N T m m`) -> mean and covariance of the positions, `N T 2` and `N T 2 2`; None where it
cannot."""


class Predictor(nn.Module, ABC):
    """Forecasts positions of the ego and its neighbors, in the frame of the given tracks.

    Args:
        horizon_steps: Number of predicted time steps T.
        dt_s: Length of one step in s.

    Attributes:
        forecast_neighbors: Whether its forecast of the neighbors means something; otherwise only
            that of the ego does, and `forecasts_of` makes everybody an ego once.

    Raises:
        ValueError: The horizon has no whole number of steps, or the step is not positive.
    """

    forecast_neighbors: bool = True

    def __init__(self, horizon_steps: int = 30, dt_s: float = 0.1) -> None:
        super().__init__()
        require_whole("horizon_steps", horizon_steps)
        require_at_least("horizon_steps", horizon_steps, 1)
        require_positive("dt_s", dt_s)
        self.horizon_steps = horizon_steps
        self.dt_s = dt_s

    @abstractmethod
    def forward(self, past: Tracks, neighbors: Tracks) -> Forecast:
        """Forecast all agents.

        Args:
            past: The ego, `*b`, with times `*b H`.
            neighbors: Its neighbors, `*b N`, with times `*b N H`; N may be 0. A neighbor counts if
                its last row is valid.

        Returns:
            Forecast with leading dimensions `*b 1+N`, finite for every agent; see `ego_forecast`,
            `neighbors_forecast`.
        """

    def predict(self, batch: StackBatch) -> Forecast:
        """Forecast the agents of a batch, `B 1+N`; the futures in it are not used."""
        return self(batch.ego_past, batch.neighbors_past)

    def predict_and_judge(self, batch: StackBatch) -> tuple[Forecast, Float[Tensor, "*b"]]:
        """`predict` and `loss` of a batch, for training steps that need both."""
        return self.predict(batch), self.loss(batch)

    def loss(self, batch: StackBatch) -> Float[Tensor, "*b"]:
        """Mean negative log density in nats of the true positions, over valid times and agents.

        Raises:
            ValueError: The samples have another step or horizon than the predictor.
        """
        self.require_fitting(batch)
        future = all_agents(batch.ego_future, batch.neighbors_future)
        seen = present_agents(batch).unsqueeze(-1) & future.valid
        # what stands in rows that are not valid must not reach the gradient
        position = torch.where(seen.unsqueeze(-1), future.motion.position, 0.0)
        log_prob = self.predict(batch).log_prob(position)
        total = torch.where(seen, log_prob, torch.zeros_like(log_prob)).sum((-2, -1))
        return -total / seen.sum((-2, -1)).clamp_min(1)

    def require_fitting(self, batch: StackBatch) -> None:
        """Refuse to judge by samples of another step or horizon: a library would not notice.

        Raises:
            ValueError: They are.
        """
        step_s, rows = batch.dt_s, batch.ego_future.valid.shape[-1]
        remedy = "Build the predictor for the samples."
        same = math.isclose(step_s, self.dt_s, rel_tol=1e-6)
        require(same, "batch.dt_s", f"be {self.dt_s:g} s as of the predictor", step_s, "", remedy)
        wanted = f"have {self.horizon_steps} rows, the steps that are predicted"
        fits = rows == self.horizon_steps
        require(fits, "batch.ego_future", wanted, rows, "", remedy)

    def compile_kernels(self, moments: GaussianRollout) -> None:
        """Have expensive parts compiled at their next use; by default there is nothing to do.

        Args:
            moments: Integrates Gaussian controls through a model in one call.
        """
        return


def all_agents(ego: Tracks, neighbors: Tracks) -> Tracks:
    """Join the ego (`*b H`) and its neighbors (`*b N H`) to agents `*b 1+N H`, the ego first.

    Raises:
        ValueError: The two differ in their number of rows.
    """
    rows, expected = neighbors.valid.shape[-1], ego.valid.shape[-1]
    require(rows == expected, "neighbors", f"have {expected} rows as the ego has", rows)
    agent_dim = ego.mode.dim()

    def join(first: Tensor, rest: Tensor) -> Tensor:
        return torch.cat([first.unsqueeze(agent_dim), rest], agent_dim)

    return Tracks(
        Motion(*(join(*fields) for fields in zip(ego.motion, neighbors.motion, strict=True))),
        *(join(*fields) for fields in zip(ego[1:], neighbors[1:], strict=True)),
    )


def present_agents(batch: StackBatch) -> Bool[Tensor, "*b agents"]:
    """Which of the agents are observed now, the ego first."""
    return all_agents(batch.ego_past, batch.neighbors_past).valid[..., -1]


def ego_forecast(forecast: Forecast) -> Forecast:
    """Forecast `*b` of the ego alone, from one of ego and neighbors `*b 1+N`."""
    return Forecast(
        forecast.log_weight[..., 0, :],
        forecast.mean[..., 0, :, :, :],
        forecast.scale_tril[..., 0, :, :, :, :],
    )


def neighbors_forecast(forecast: Forecast) -> Forecast:
    """Forecast `*b N` of the neighbors alone, from one of ego and neighbors `*b 1+N`."""
    return Forecast(
        forecast.log_weight[..., 1:, :],
        forecast.mean[..., 1:, :, :, :],
        forecast.scale_tril[..., 1:, :, :, :, :],
    )


def forecasts_of(predictor: Predictor, agents: Tracks) -> Forecast:
    """Forecast agents `*b N` of whom none is the ego, `*b N` again.

    They are the neighbors of an ego that is not there, or, of a predictor that forecasts egos only,
    each is the ego once and the others are its neighbors.
    """
    agent_dim = agents.mode.dim() - 1
    count = agents.mode.shape[-1]
    if predictor.forecast_neighbors:
        absent = map_tensors(
            lambda entry: entry.new_zeros(
                (*entry.shape[:agent_dim], *entry.shape[agent_dim + 1 :])
            ),
            agents,
        )
        return neighbors_forecast(predictor(absent, agents))
    number = torch.arange(count, device=agents.mode.device)
    others = number.repeat(count, 1)[number != number.unsqueeze(-1)]
    beside = map_tensors(
        lambda entry: entry.index_select(agent_dim, others).unflatten(
            agent_dim, (count, max(count - 1, 0))
        ),
        agents,
    )
    return ego_forecast(predictor(agents, beside))


def strongest(forecast: Forecast, components: int) -> Forecast:
    """Keep at most that many components, those with the largest weights, and renormalise.

    Raises:
        ValueError: `components` is below one.
    """
    require_at_least("components", components, 1)
    count = min(components, forecast.log_weight.shape[-1])
    log_weight, index = forecast.log_weight.topk(count, -1)
    return taken(forecast, index)._replace(log_weight=log_weight.log_softmax(-1))
