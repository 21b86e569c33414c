"""Interaction between the agents of a scene."""

import pytest
import torch

from diffstack_mmv.prediction.base import all_agents
from diffstack_mmv.prediction.trajectron.agent_batch import agent_batch
from diffstack_mmv.prediction.trajectron.interaction import (
    Interaction,
    gather_by_attention,
    neighboring_rows,
)
from diffstack_mmv.types import map_tensors
from tests.prediction.samples import DT_S, scene


def rows_of(batch):
    return agent_batch(all_agents(batch.ego_past, batch.neighbors_past), DT_S)


def far(batch, distance):
    """Put the neighbors at a distance in m from the ego, side by side."""
    motion = batch.neighbors_past.motion
    shift = batch.ego_past.motion.position[:, -1:].unsqueeze(1) - motion.position[:, :, -1:]
    offset = torch.tensor([distance, 0.0]) * (
        1 + 0.01 * torch.arange(motion.heading.shape[1])[:, None, None]
    )
    moved = motion._replace(position=motion.position + shift + offset)
    return batch._replace(neighbors_past=batch.neighbors_past._replace(motion=moved))


def test_pairs_are_those_within_a_scene():
    index = torch.tensor([0, 2, 3, 4, 5])
    first, second = neighboring_rows(index, 3)
    pairs = {(int(index[a]), int(index[b])) for a, b in zip(first, second, strict=True)}
    assert pairs == {(0, 2), (2, 0), (3, 4), (4, 3), (3, 5), (5, 3), (4, 5), (5, 4)}


def test_attention_equals_a_loop_over_agents():
    agent, score, edge = torch.tensor([0, 0, 2, 2, 2]), torch.randn(5), torch.randn(5, 4)
    found = gather_by_attention(agent, score, edge, 4)
    for row in range(4):
        mine = agent == row
        weight = score[mine].exp() / (1 + score[mine].exp().sum())
        assert torch.allclose(found[row], weight @ edge[mine], atol=1e-6)


def test_attention_is_stable_for_large_scores():
    found = gather_by_attention(
        torch.zeros(2, dtype=torch.long), torch.tensor([500.0, -500.0]), torch.eye(2), 1
    )
    assert torch.allclose(found, torch.tensor([[1.0, 0.0]]))


@pytest.mark.parametrize(
    ("distance", "smallest", "largest"), [(3.0, 1e-2, 1e2), (28.0, 0.0, 1e-2), (200.0, 0.0, 0.0)]
)
def test_influence_fades_with_distance(distance, smallest, largest):
    batch = far(scene(neighbors=2), distance)
    rows = rows_of(batch)
    encoding = Interaction(8, 8)(rows, 3, torch.randn(len(rows.index), 8))
    ego = encoding[rows.role == 0].abs().max()
    assert smallest <= ego <= largest


def test_order_of_the_neighbors_does_not_matter():
    batch = far(scene(neighbors=2), 5.0)
    interaction, rows = Interaction(8, 8), rows_of(batch)
    node = torch.randn(len(rows.index), 8)
    order = torch.tensor([0, 2, 1, 3, 5, 4, 6, 8, 7])
    shuffled = map_tensors(lambda field: field[order], rows)._replace(index=rows.index)
    assert torch.allclose(
        interaction(rows, 3, node)[order], interaction(shuffled, 3, node[order]), atol=1e-5
    )


def test_an_agent_alone_has_a_zero_encoding():
    rows = rows_of(scene(neighbors=0))
    assert Interaction(8, 8)(rows, 1, torch.randn(3, 8)).abs().max() == 0
