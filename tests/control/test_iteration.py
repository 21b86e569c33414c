"""How much the next iteration is damped, and its convex model lifted."""

import pytest
import torch

from diffstack_mmv.control.iteration import LARGE, SHARE_MIN, next_damping, next_share


@pytest.mark.parametrize(
    ("damping", "accepted", "size", "following"),
    [
        (1.0, True, 1.0, 0.2),  # a long step: less
        (1.0, True, 0.25, 1.0),  # a short one says nothing
        (0.9e-7, True, 0.25, 0.0),  # what is next to nothing is gone
        (4e-7, True, 1.0, 0.0),
        (1.0, False, 1.0, 8.0),  # refused: more
        (0.0, False, 1.0, 1e-6),  # and at least the regularisation
    ],
)
def test_damping_follows_the_step(damping, accepted, size, following):
    damping, size = torch.tensor([[damping], [size]], dtype=torch.float64)
    least = torch.tensor(1e-6, dtype=torch.float64)
    found = next_damping(damping, torch.tensor([accepted]), size, least)
    assert found.item() == pytest.approx(following)


def test_damping_of_one_problem_is_free_of_its_mates():
    damping, accepted = torch.rand(20).double(), torch.rand(20) < 0.5
    size, least = torch.rand(20).double(), torch.tensor(1e-3).double()
    together = next_damping(damping, accepted, size, least)
    rows = zip(damping.split(1), accepted.split(1), size.split(1), strict=True)
    assert torch.equal(together, torch.cat([next_damping(*row, least) for row in rows]))


@pytest.mark.parametrize(
    ("share", "accepted", "size", "following"),
    [
        (1.0, True, 1.0, 0.1),  # a long step: less
        (1.0, True, 0.5, 0.1),
        (0.1, True, 0.25, 0.4),  # a short one: more
        (0.1, False, 1.0, 0.4),  # refused: more
        (0.5, False, 1.0, 1.0),  # and never more than all
        (2e-4, True, 1.0, SHARE_MIN),
    ],
)
def test_lift_of_a_large_model_follows_the_step(share, accepted, size, following):
    share, size = torch.tensor([[share], [size]], dtype=torch.float64)
    accepted = torch.tensor([accepted])
    assert next_share(share, accepted, size, LARGE).item() == pytest.approx(following)
    assert torch.equal(next_share(share, accepted, size, LARGE - 1), share)
