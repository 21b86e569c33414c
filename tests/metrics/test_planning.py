"""Collisions of plans."""

import pytest
import torch

from diffstack_mmv.metrics import collides, overlap_now
from diffstack_mmv.types import Obstacles


def standing_agent(x, y, valid=True):
    return Obstacles(
        torch.tensor([x, y]).expand(1, 1, 1, 31, 2),
        torch.ones(1, 1, 1),
        torch.full((1, 1), 0.3),
        torch.tensor([[valid]]),
    )


def straight_plan():
    return torch.stack([torch.linspace(0, 10, 31), torch.zeros(31)], -1).unsqueeze(0)


@pytest.mark.parametrize(
    ("x", "y", "valid", "expected"),
    [
        (5.0, 0.5, True, True),
        (5.0, 0.7, True, False),
        (5.0, 0.0, False, False),
        (20.0, 0.0, True, False),
    ],
)
def test_plan_collides_where_discs_overlap(x, y, valid, expected):
    hit = collides(straight_plan(), torch.tensor([0.3]), standing_agent(x, y, valid))
    assert hit.item() is expected


def test_overlap_at_the_start_is_no_fault_of_the_plan():
    agent = standing_agent(-0.2, 0.0)
    assert overlap_now(torch.zeros(1, 2), torch.tensor([0.3]), agent).item()
    assert not collides(
        straight_plan() + torch.tensor([1.0, 0.0]), torch.tensor([0.3]), agent
    ).item()


def test_no_agents_no_collision():
    none = Obstacles(
        torch.zeros(1, 0, 1, 31, 2),
        torch.zeros(1, 0, 1),
        torch.zeros(1, 0),
        torch.zeros(1, 0, dtype=torch.bool),
    )
    assert not collides(straight_plan(), torch.tensor([0.3]), none).item()
