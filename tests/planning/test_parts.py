"""Costs computed some problems at a time are those computed at once."""

from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from diffstack_mmv.planning import parts
from diffstack_mmv.types import Obstacles

pytestmark = pytest.mark.usefixtures("unchecked")


class Around(NamedTuple):
    """Stand-in for a problem."""

    obstacles: NamedTuple


class Agents(NamedTuple):
    """Stand-in for obstacles."""

    position: Tensor


@pytest.mark.parametrize("graded", [True, False])
def test_costs_in_parts_are_those_of_the_whole(monkeypatch, graded):
    motion, controls = torch.randn(5, 3, 2, 4), torch.randn(5, 3, 4, 2)
    position = torch.randn(5, 1, 2, 1, 4, 2, requires_grad=graded)
    monkeypatch.setattr(parts, "LARGEST", 24)

    def counted(motion, controls, problem):
        assert len(motion) <= 1
        away = motion - problem.obstacles.position[:, :, :, 0, :, 0]
        return away.square().sum(-2) + controls.sum(-1)

    problem = Around(Agents(position))
    found = parts.cost_in_parts(counted, motion, controls, problem)
    away = motion - position[:, :, :, 0, :, 0]
    expected = away.square().sum(-2) + controls.sum(-1)
    assert torch.equal(found, expected)
    if graded:
        first, second = (torch.autograd.grad(each.sum(), position)[0] for each in (found, expected))
        assert torch.allclose(first, second)


def test_possible_components_are_agents_of_their_own():
    weight = torch.tensor([[[0.5, 0.5], [1.0, 0.0]], [[0.0, 1.0], [1.0, 0.0]]])
    valid = torch.tensor([[True, True], [True, False]])
    position = torch.randn(2, 2, 2, 4, 2)
    agents = Obstacles(position, weight, torch.tensor([[0.3, 0.4], [0.5, 0.6]]), valid)
    found = parts.possible(agents)
    assert found.valid.tolist() == [[True, True, True], [True, False, False]]
    assert found.weight[0, :, 0].tolist() == [0.5, 0.5, 1.0]
    assert found.radius[0].tolist() == pytest.approx([0.3, 0.3, 0.4])
    assert torch.equal(found.position[0, :, 0], position[0].flatten(0, 1)[:3])
    assert torch.equal(found.position[1, 0, 0], position[1, 0, 1])
    assert found.weight[1, 0].item() == 1.0


def test_where_all_components_are_possible_or_none_nothing_changes():
    weight, radius = torch.ones(2, 3, 1), torch.ones(2, 3)
    for there in (True, False):
        valid = torch.full((2, 3), there)
        agents = Obstacles(torch.randn(2, 3, 1, 4, 2), weight, radius, valid)
        assert parts.possible(agents) is agents
