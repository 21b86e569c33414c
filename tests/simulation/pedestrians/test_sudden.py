"""People who stop or turn off at any time."""

import pytest
import torch

from diffstack_mmv.simulation import OrcaCrowd, SuddenCrowd
from diffstack_mmv.simulation.pedestrians import CrowdState

SIDE = 8


@pytest.fixture
def crowd():
    """People far from each other who walk along x."""
    places = 5.0 * torch.arange(SIDE, dtype=torch.float64)
    position = torch.cartesian_prod(places, places)[None]
    along = torch.tensor([1.0, 0.0], dtype=torch.float64).expand_as(position)
    one = torch.ones(1, SIDE**2, dtype=torch.float64)
    return CrowdState(position, along, position + 9.0 * along, 0.3 * one, one)


@pytest.mark.parametrize(("chance", "least", "most"), [(0.0, 0, 0), (0.5, 20, 44), (1.0, 64, 64)])
def test_who_turns_off_does_so_to_either_side_as_often(crowd, chance, least, most):
    sudden = SuddenCrowd(OrcaCrowd(), stop_chance=0.0, turn_chance=chance, turn_deg=75.0)
    aside = sudden(crowd, 0.25)[0, :, 1]
    left, right = (int((sign * aside > 0.5).sum()) for sign in (1, -1))
    assert least <= left + right <= most
    assert min(left, right) >= 0.3 * (left + right)
