"""How much the next iteration is damped."""

import pytest
import torch

from diffstack_mmv.control.iteration import next_damping


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
