"""Trajectron++ for micro-mobility: one forward pass for the ego and all its neighbors."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.checks import require, require_at_least, require_switch, require_whole
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.prediction.base import GaussianRollout, Predictor, all_agents
from diffstack_mmv.prediction.gaussian import log_of_sum
from diffstack_mmv.prediction.trajectron.agent_batch import (
    EGO,
    PEDESTRIAN,
    VEHICLE,
    AgentBatch,
    agent_batch,
    in_own_frame,
    rows_of_role,
    select_agents,
    take_rows,
)
from diffstack_mmv.prediction.trajectron.blocks import Blocks
from diffstack_mmv.prediction.trajectron.decoder import ControlDecoder, Jacobians
from diffstack_mmv.prediction.trajectron.encoder import (
    TRACK_FEATURES,
    PerKind,
    track_features,
)
from diffstack_mmv.prediction.trajectron.jacobians import linearise
from diffstack_mmv.prediction.trajectron.latent import Annealing, Latent, divergence
from diffstack_mmv.prediction.trajectron.memory import MaskedLSTM
from diffstack_mmv.prediction.trajectron.mixture import PositionMoments
from diffstack_mmv.prediction.trajectron.output import nobody, placed, scenes
from diffstack_mmv.prediction.trajectron.paths import path_scores
from diffstack_mmv.prediction.trajectron.rows import ChosenRows
from diffstack_mmv.prediction.trajectron.scene import SceneEncoder
from diffstack_mmv.prediction.trajectron.site import Site
from diffstack_mmv.prediction.trajectron.sizes import Sizes
from diffstack_mmv.types import Forecast, Pose, StackBatch, Tracks


class Branch(nn.Module):
    """Latent variable and decoder of the agents of one role.

    Args:
        latent: Distribution over the components.
        decoder: Makes positions of each component.
    """

    def __init__(self, latent: Latent, decoder: ControlDecoder) -> None:
        super().__init__()
        self.latent = latent
        self.decoder = decoder


class Decoded(NamedTuple):
    """What one branch made of its rows."""

    places: ChosenRows  # S, of the rows among all agents
    rows: AgentBatch  # S
    context: Float[Tensor, "S c"]
    log_prior: Float[Tensor, "S K"]
    moments: PositionMoments  # S K T, in the own frames
    latent: Latent


class Trajectron(Predictor):
    """CVAE over controls, integrated through the dynamics of each agent.

    History LSTM per kind of agent, attention over the neighbors, discrete latent variable, GRU
    decoder over controls, first-order propagation of covariances: single integrator for
    pedestrians, `vehicle_dynamics` for vehicles, and for the ego the dynamics it is going to be
    controlled with. Every agent is seen in its own frame, so that a turned scene gives the turned
    forecast. Source: Salzmann et al., Trajectron++ (ECCV 2020); Karkus et al., DiffStack (CoRL
    2022).

    Args:
        ego_dynamics: Dynamics of the ego.
        vehicle_dynamics: Dynamics of all other vehicles.
        pedestrian_dynamics: Dynamics of those who walk.
        horizon_steps: Number of predicted time steps T.
        components: Number K of components of the ego.
        neighbor_components: Number of components of each neighbor; with 0 neighbors are only seen:
            their forecast is that they stay, and nothing is learned from them. For benchmarks in
            which every agent is an ego once.
        sizes: Sizes of the networks.
        annealing: Weight of the divergence of the posterior from the prior.
        energy_weight: Weight in nats per m of `energy_of_paths` in the loss; 0 as published.
        jacobians: Linearises the dynamics: `linearise` at every point, or `linearise_shared` at the
            mean of the components, for models whose step is expensive.
        generated: Integrates the controls in one call where it can, see `integrate`.
        site: Encoder of where in the world an agent is, for a predictor that is used where it was
            trained; None: no site encoding. It is also left out when only tracks are given.
        rough: Whether it is told how noisy each track is, see `roughness`: for recordings that are
            not smoothed and not equally noisy.

    Raises:
        ValueError: The models differ in their time step, or a number is out of its range.
    """

    def __init__(  # noqa: PLR0913 - each is a part that can be exchanged
        self,
        ego_dynamics: DynamicsModel,
        vehicle_dynamics: DynamicsModel,
        pedestrian_dynamics: DynamicsModel,
        horizon_steps: int = 30,
        components: int = 25,
        neighbor_components: int = 5,
        sizes: Sizes | None = None,
        annealing: Annealing | None = None,
        energy_weight: float = 0.0,
        jacobians: Jacobians = linearise,
        generated: GaussianRollout | None = None,
        site: Site | None = None,
        rough: bool = False,
    ) -> None:
        super().__init__(horizon_steps, ego_dynamics.dt_s)
        counts = ("components", components, 1), ("neighbor_components", neighbor_components, 0)
        for name, count, least in counts:
            require_whole(name, count)
            require_at_least(name, count, least)
        require_switch("rough", rough)
        self.forecast_neighbors = neighbor_components > 0
        models = {EGO: ego_dynamics, VEHICLE: vehicle_dynamics, PEDESTRIAN: pedestrian_dynamics}
        steps = [model.dt_s for model in models.values()]
        require(len(set(steps)) == 1, "dt_s", "be the same for all three dynamics", steps)
        sizes = sizes if sizes is not None else Sizes()
        require_at_least("energy_weight", energy_weight, 0.0)
        self.energy_weight = energy_weight
        self.blocks: Blocks | None = None
        self.annealing = annealing if annealing is not None else Annealing()
        self.scene_encoder = SceneEncoder(self.dt_s, sizes, site, rough)
        self.future_encoder = PerKind(
            {kind: MaskedLSTM(TRACK_FEATURES, sizes.future) for kind in (VEHICLE, PEDESTRIAN)},
            sizes.future,
        )
        self.components = max(components, neighbor_components)
        context = self.scene_encoder.outputs
        self.branches = nn.ModuleList()
        for role, model in models.items():
            count = components if role == EGO else max(neighbor_components, 1)
            decoder = ControlDecoder(
                model, context, count, horizon_steps, sizes.decoder,
                sizes.dropout, jacobians, generated,
            )  # fmt: skip
            self.branches.append(Branch(Latent(context, sizes.future, count), decoder))
        self.register_buffer("training_step", torch.zeros((), dtype=torch.long))
        self.training_step: Tensor

    def compile_kernels(self, moments: GaussianRollout) -> None:
        """Take recurrences and integration through all steps in one call from now on.

        Where that is possible: the recurrences on a CPU, both with a C++ compiler.
        """
        self.blocks = Blocks()
        for branch in self._branches():
            branch.decoder.compile_kernels(moments)
        for module in self.modules():
            if isinstance(module, MaskedLSTM):
                module.compile_kernels()

    def has_learned(self, role: int) -> bool:
        """Whether the decoder of a role ever got a gradient: its heads start at zero.

        Args:
            role: EGO, VEHICLE or PEDESTRIAN of `agent_batch`.
        """
        return bool(self._branches()[role].decoder.mean_head.weight.any())

    def _branches(self) -> list[Branch]:
        """The branches in the order of their roles; a module list does not tell their type."""
        return [branch for branch in self.branches if isinstance(branch, Branch)]

    def forward(self, past: Tracks, neighbors: Tracks) -> Forecast:
        """Forecast all agents, `*b 1+N`; an agent that is not observed now stays where it is."""
        return self._forward(all_agents(past, neighbors), None)

    def predict(self, batch: StackBatch) -> Forecast:
        """Forecast the agents of a batch, `B 1+N`, at their place in the world if that is known."""
        return self._forward(all_agents(batch.ego_past, batch.neighbors_past), batch.frame)

    def _forward(self, agents: Tracks, frame: Pose | None) -> Forecast:
        flat = scenes(agents)
        parts = self._decoded(agent_batch(flat, self.dt_s, frame), flat.mode.shape[1])
        return self._forecast(agents, parts)

    def loss(self, batch: StackBatch) -> Float[Tensor, "*b"]:
        """Negative evidence bound in nats per predicted time step, mean over a sample's agents.

            -log Σ_z q(z|x, y) Π_t p(y_t|x, z) + β max(KL(q || p) - free, 0) + w T energy

        with the components weighted by the posterior inside of the logarithm, as in the code of the
        sources, and the energy score of the mixture by the prior, see `energy_of_paths`. Each call
        in training mode is one step of the annealing of β.

        Raises:
            ValueError: The samples have another step or horizon than the predictor.
        """
        return self._judged(batch)[1]

    def predict_and_judge(self, batch: StackBatch) -> tuple[Forecast, Float[Tensor, "*b"]]:
        """`predict` and `loss` of a batch, with one pass through encoder and decoder."""
        parts, loss = self._judged(batch)
        return self._forecast(all_agents(batch.ego_past, batch.neighbors_past), parts), loss

    def _forecast(self, agents: Tracks, parts: Iterable[Decoded]) -> Forecast:
        """Forecast of agents `*b A` from what the branches made of those that are present."""
        forecast = nobody(scenes(agents), self.components, self.horizon_steps)
        for part in parts:
            forecast = placed(forecast, part.places, part.rows, part.log_prior, part.moments)
        return Forecast(
            *(field.reshape(*agents.mode.shape, *field.shape[1:]) for field in forecast)
        )

    def _judged(self, batch: StackBatch) -> tuple[list[Decoded], Float[Tensor, "*b"]]:
        """Decode the agents of a batch, and compute the loss of each sample."""
        self.require_fitting(batch)
        agents = scenes(all_agents(batch.ego_past, batch.neighbors_past))
        futures = scenes(all_agents(batch.ego_future, batch.neighbors_future))
        rows = agent_batch(agents, self.dt_s, batch.frame)
        parts = list(self._decoded(rows, agents.mode.shape[1]))
        loss = rows.origin.new_zeros(agents.mode.numel())
        for part in parts:
            future = take_rows(futures, part.rows.index)
            future = in_own_frame(future, part.rows.origin, part.rows.heading)
            loss = part.places.put(loss, self._row_loss(part, future))
        if self.training:
            self.training_step += 1
        judged = agents.valid[..., -1] & futures.valid.any(-1)
        judged = judged if self.forecast_neighbors else judged[..., :1]
        loss = loss.reshape(agents.mode.shape)[..., : judged.shape[-1]]
        per_agent = torch.where(judged, loss, 0.0)
        per_sample = per_agent.sum(-1) / judged.sum(-1).clamp_min(1)
        return parts, per_sample.reshape(batch.ego_past.mode.shape)

    def _decoded(self, rows: AgentBatch, agents: int) -> Iterator[Decoded]:
        """Encode all rows at once, and decode them by their roles."""
        given, own = rows.origin.dtype, next(self.parameters()).dtype
        remedy = "Convert the tracks, or the predictor by .float() or .double()."
        require(given == own, "past.motion", f"be {own} as the predictor", given, "", remedy)
        context = self.scene_encoder(rows, agents, not self.forecast_neighbors)
        for role, branch in enumerate(self._branches()):
            if role != EGO and not self.forecast_neighbors:
                continue
            chosen = rows_of_role(rows, role, agents)
            if len(chosen.index) > 0:
                own, seen = select_agents(rows, chosen.index), context[chosen.index]
                places = chosen._replace(index=own.index)
                moments = branch.decoder(seen, own)
                yield Decoded(
                    places, own, seen, branch.latent.log_prior(seen), moments, branch.latent
                )

    def _row_loss(self, part: Decoded, future: Tracks) -> Float[Tensor, " S"]:
        """Negative evidence bound of each row in nats per predicted time step."""
        seen = track_features(future, part.rows.velocity, self.dt_s, -1)
        encoded = self.future_encoder(part.rows.kind, seen, future.valid)
        log_posterior = part.latent.log_posterior(part.context, encoded)
        weighed = part.log_prior if self.energy_weight > 0 else None
        truth = future.motion.position, future.valid
        scores = path_scores(part.moments, weighed, *truth, self.blocks)
        likelihood = log_of_sum(log_posterior + scores.log_density)
        penalty = self.annealing.penalty(
            divergence(log_posterior, part.log_prior), self.training_step
        )
        bound = (penalty - likelihood) / future.valid.sum(-1).clamp_min(1)
        return bound + self.energy_weight * scores.energy
