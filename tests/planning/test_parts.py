"""Costs computed some problems at a time are those computed at once."""

from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from diffstack_mmv.planning import parts

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
