"""Interaction between the agents of a scene."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from diffstack_mmv.prediction.base import all_agents
from diffstack_mmv.prediction.trajectron.agent_batch import agent_batch
from diffstack_mmv.prediction.trajectron.interaction import (
    APPROACH_S,
    Interaction,
    closest_approach_s,
    edge_features,
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
@pytest.mark.parametrize("detail", [None, 1.0])
def test_influence_fades_with_distance(distance, smallest, largest, detail):
    batch = far(scene(neighbors=2), distance)
    rows = rows_of(batch)
    encoding = Interaction(8, 8, detail_m=detail)(rows, 3, torch.randn(len(rows.index), 8))
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


def pair(offset, velocity):
    """An ego at 2 m/s along its own x, which is the y of the world, and one who is seen from it."""
    rows = rows_of(scene(batch=(1,), neighbors=1))
    seen = torch.stack([-offset[..., 1], offset[..., 0]], -1)
    return rows._replace(
        origin=torch.stack([torch.zeros(2), seen]),
        heading=torch.tensor([math.pi / 2, 0.0]),
        velocity=torch.stack([torch.tensor([2.0, 0.0]), velocity]),
    )


@pytest.mark.parametrize(
    ("offset", "velocity", "closest", "time_s"),
    [
        ([4.0, 1.0], [0.0, 0.0], [0.0, 1.0], 2.0),  # stands beside the way
        ([-4.0, 1.0], [0.0, 0.0], [-4.0, 1.0], 0.0),  # is behind already
        ([6.0, 0.5], [0.0, 2.0], [6.0, 0.5], 0.0),  # moves as the ego, with the world's y
        ([60.0, 0.0], [0.0, 0.0], [60.0 - 2 * APPROACH_S, 0.0], APPROACH_S),  # is far
    ],
)
def test_edges_tell_place_and_closest_approach(offset, velocity, closest, time_s):
    rows = pair(torch.tensor(offset), torch.tensor(velocity))
    found = edge_features(rows, torch.tensor([0]), torch.tensor([1]), detail_m=0.5)[0]
    assert found.shape == (11,)
    torch.testing.assert_close(found[:2].sinh() * 0.5, torch.tensor(offset))
    torch.testing.assert_close(found[2:4].sinh() * 0.5, torch.tensor(closest), rtol=0.01, atol=0.02)
    assert math.isclose(found[4] * APPROACH_S, time_s, rel_tol=0.01, abs_tol=1e-4)
    usual = edge_features(rows, torch.tensor([0]), torch.tensor([1]))[0]
    torch.testing.assert_close(usual[:2] * 10, torch.tensor(offset))
    assert torch.equal(found[5:], usual[2:])


@given(st.lists(st.floats(-30, 30), min_size=2, max_size=2), st.floats(-3, 3), st.floats(-3, 3))
def test_no_other_time_is_closer(offset, forward, left):
    place, relative = torch.tensor(offset), torch.tensor([forward, left])
    time_s = closest_approach_s(place, relative)
    others = torch.linspace(0, APPROACH_S, 41)
    least = (place + relative * others[:, None]).norm(dim=-1).min()
    # what is nearly at rest to each other counts as at rest
    assert (place + relative * time_s).norm() <= least + 0.1 * APPROACH_S


@pytest.mark.parametrize(("detail", "learned"), [(None, False), (1.0, True)])
def test_with_detail_it_learns_who_stands_in_the_way(detail, learned):
    count, interaction = 64, Interaction(4, 16, detail_m=detail)
    rows = rows_of(scene(batch=(count,), neighbors=1))
    ego = rows.role == 0
    optimizer = torch.optim.Adam(interaction.parameters(), 1e-2)
    for _ in range(200):
        ahead = torch.rand(count) < 0.5
        side = torch.where(torch.rand(count) < 0.5, 3.0, -3.0) * ~ahead
        place = torch.stack([8 + 2 * torch.rand(count), side + 0.3 * torch.randn(count)], -1)
        told = rows._replace(
            origin=torch.zeros(2 * count, 2).index_put((~ego,), place),
            heading=torch.zeros(2 * count),
            velocity=torch.zeros(2 * count, 2).index_put((ego,), torch.tensor([4.0, 0.0])),
        )
        encoding = interaction(told, 2, torch.zeros(2 * count, 4), ego_only=True)[ego]
        loss = (encoding.sum(-1) - ahead.float()).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert (loss < 0.05) == learned


@pytest.mark.parametrize("detail", [0.0, -1.0, math.nan])
def test_a_detail_that_is_no_length_is_refused(detail):
    with pytest.raises(ValueError, match="`detail_m` must be positive"):
        Interaction(8, 8, detail_m=detail)
