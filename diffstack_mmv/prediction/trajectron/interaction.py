"""How the agents around an agent influence it: edge encoders and their aggregation by attention."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from diffstack_mmv.checks import require_positive
from diffstack_mmv.geometry import direction, rotate
from diffstack_mmv.prediction.trajectron.agent_batch import PEDESTRIAN, VEHICLE, AgentBatch
from diffstack_mmv.prediction.trajectron.encoder import (
    POSITION_SCALE_M,
    SPEED_SCALE_MPS,
    PerKind,
    perceptron,
)
from diffstack_mmv.prediction.trajectron.rows import chosen
from diffstack_mmv.smooth import safe_norm
from diffstack_mmv.types import on_host

EDGE_FEATURES = {False: 8, True: 11}
"""Number of features of an edge, without and with `detail_m`."""
APPROACH_S = 4.0
"""Within this time the closest approach of a pair is looked for."""
APPROACH_MPS = 0.1
"""Of order, what two velocities differ by that are the same: below, the present is the closest."""


class Interaction(nn.Module):
    """Sum of edge encodings e_ij with additive attention, gated by distance.

        s_ij = w · tanh(W_q h_i + W_k e_ij) + log g(d_ij),    g(d) = 1 / (1 + exp((d - r) / σ))
        out_i = Σ_j exp(s_ij) e_ij / (1 + Σ_j exp(s_ij))

    The one in the denominator is an agent that does not exist: the influence of agents out of reach
    fades to zero, and an agent that is alone has a zero encoding. An edge encoder per pair of kinds
    sees the neighbor's history and its motion relative to the agent, in the agent's frame. Source:
    Salzmann et al., Trajectron++ (ECCV 2020), Sec. 4, which sums the neighbors of a kind before it
    encodes them, with a radius per pair of kinds; the gate here is smooth.

    Args:
        node_size: Size of the encodings h of histories.
        edge_size: Size of the encodings e of edges.
        reach_m: r, the distance at which the influence is halved.
        fade_m: σ.
        dropout: Share of units dropped in training.
        detail_m: Length up to which places of neighbors are told apart, see `edge_features`.

    Raises:
        ValueError: The reach, its fading or the detail is not positive.
    """

    def __init__(
        self,
        node_size: int = 32,
        edge_size: int = 32,
        reach_m: float = 15.0,
        fade_m: float = 2.0,
        dropout: float = 0.0,
        detail_m: float | None = None,
    ) -> None:
        super().__init__()
        lengths = {"reach_m": reach_m, "fade_m": fade_m, "detail_m": detail_m}
        for name, length in lengths.items():
            if length is not None:
                require_positive(name, length)
        self.reach_m, self.fade_m, self.edge_size = reach_m, fade_m, edge_size
        self.detail_m = detail_m
        sizes = [node_size + EDGE_FEATURES[detail_m is not None], edge_size, edge_size]
        pairs = [
            pair_of_kinds(agent, other)
            for agent in (VEHICLE, PEDESTRIAN)
            for other in (VEHICLE, PEDESTRIAN)
        ]
        self.edge_encoders = PerKind(
            {int(pair): perceptron(sizes, dropout) for pair in pairs}, edge_size
        )
        self.query = nn.Linear(node_size, edge_size)
        self.key = nn.Linear(edge_size, edge_size, bias=False)
        self.score = nn.Linear(edge_size, 1, bias=False)

    def forward(
        self,
        rows: AgentBatch,
        agents: int,
        node: Float[Tensor, "R h"],
        ego_only: bool = False,
    ) -> Float[Tensor, "R e"]:
        """Encode the influence of the others on each row, with so many `agents` per scene.

        With `ego_only` the rows of neighbors get zeros.
        """
        agent, other = neighboring_rows(rows.index, agents, ego_only)
        distance = safe_norm(rows.origin[other] - rows.origin[agent])
        near = distance < self.reach_m + 8 * self.fade_m
        pairs = chosen(near & rows.present[agent] & rows.present[other])
        agent, other, distance = agent[pairs.index], other[pairs.index], distance[pairs.index]
        # rows by number: of an index the slopes would be sorted before they are added up
        seen = node.index_select(0, other)
        features = torch.cat([seen, edge_features(rows, agent, other, self.detail_m)], -1)
        edge = self.edge_encoders(pair_of_kinds(rows.kind[agent], rows.kind[other]), features)
        gate = nn.functional.logsigmoid((self.reach_m - distance) / self.fade_m)
        query = self.query(node).index_select(0, agent)
        score = self.score(torch.tanh(query + self.key(edge))).squeeze(-1) + gate
        if pairs.kept is not None:
            score = torch.where(pairs.kept, score, -torch.inf)
        return gather_by_attention(agent, score, edge, len(node))


def gather_by_attention(
    agent: Int[Tensor, " P"], score: Float[Tensor, " P"], edge: Float[Tensor, "P e"], rows: int
) -> Float[Tensor, "R e"]:
    """Weighted sum of the edges of each row, with one more edge of score and value zero."""
    largest = score.new_zeros(rows).scatter_reduce(0, agent, score.detach(), "amax")
    weight = (score - largest[agent]).exp()
    total = torch.exp(-largest).index_add(0, agent, weight)
    summed = edge.new_zeros(rows, edge.shape[-1]).index_add(0, agent, weight.unsqueeze(-1) * edge)
    return summed / total.unsqueeze(-1)


def neighboring_rows(
    index: Int[Tensor, " R"], agents: int, ego_only: bool = False
) -> tuple[Int[Tensor, " P"], Int[Tensor, " P"]]:
    """All ordered pairs of different rows of the same scene, or those of its ego alone."""
    if not on_host(index):  # a row for every agent
        return _all_pairs(index.reshape(-1, agents), ego_only)
    scenes = int(index.max() // agents) + 1 if len(index) > 0 else 0
    row_of = torch.full((scenes * agents,), -1, device=index.device)
    row_of[index] = torch.arange(len(index), device=index.device)
    table = row_of.reshape(scenes, agents)
    present: Bool[Tensor, "B A A"] = (table >= 0).unsqueeze(2) & (table >= 0).unsqueeze(1)
    present = present & ~torch.eye(agents, dtype=torch.bool, device=index.device)
    if ego_only:
        present = present[:, :1]
    scene, first, second = present.nonzero().unbind(-1)
    return table[scene, first], table[scene, second]


def _all_pairs(
    row: Int[Tensor, "B A"], ego_only: bool
) -> tuple[Int[Tensor, " P"], Int[Tensor, " P"]]:
    """Pairs of each agent, or of the first one of each scene, with all others."""
    agents = row.shape[1]
    first = torch.arange(1 if ego_only else agents, device=row.device).unsqueeze(-1)
    second = (first + torch.arange(1, agents, device=row.device)) % agents
    return row[:, first.expand_as(second)].flatten(), row[:, second].flatten()


def pair_of_kinds(
    agent: Int[Tensor, " P"] | int, other: Int[Tensor, " P"] | int
) -> Int[Tensor, " P"] | int:
    """Number of a pair of kinds."""
    return 10 * agent + other


def edge_features(
    rows: AgentBatch,
    agent: Int[Tensor, " P"],
    other: Int[Tensor, " P"],
    detail_m: float | None = None,
) -> Float[Tensor, "P f"]:
    """Position, velocity and direction of the others in the agents' frames, of order one.

    In units of 10 m somebody in the way and somebody beside it look nearly the same, and a network
    does not learn to tell them apart. With `detail_m` places are asinh(x / detail_m), linear up to
    there and logarithmic beyond, and the closest approach is told as well: where the other will be
    then, and when, if both keep their velocities.

    Args:
        rows: The agents.
        agent: Rows of those who are influenced.
        other: Rows of those who influence them.
        detail_m: Length in m up to which places are told apart; None: units of 10 m, and no
            closest approach.

    Returns:
        Eight features per pair, eleven with `detail_m`.
    """
    offset = rotate(rows.origin[other] - rows.origin[agent], -rows.heading[agent])
    turned = rows.heading[other] - rows.heading[agent]
    velocity = rotate(rows.velocity[other], turned)
    relative = velocity - rows.velocity[agent]
    if detail_m is None:
        places = [offset / POSITION_SCALE_M]
    else:
        time_s = closest_approach_s(offset, relative).unsqueeze(-1)
        closest = offset + relative * time_s
        places = [torch.asinh(place / detail_m) for place in (offset, closest)]
        places.append(time_s / APPROACH_S)
    speeds = [velocity / SPEED_SCALE_MPS, relative / SPEED_SCALE_MPS]
    return torch.cat([*places, *speeds, direction(turned)], -1)


def closest_approach_s(
    offset: Float[Tensor, "*b 2"], relative: Float[Tensor, "*b 2"]
) -> Float[Tensor, "*b"]:
    """Time in s, up to `APPROACH_S`, until two with constant velocities are closest.

    Args:
        offset: Position of one seen from the other, in m.
        relative: Velocity of the one less that of the other, in m/s.
    """
    approach = -(offset * relative).sum(-1)
    return (approach / (relative.square().sum(-1) + APPROACH_MPS**2)).clamp(0, APPROACH_S)
