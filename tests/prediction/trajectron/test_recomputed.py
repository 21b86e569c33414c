"""Backward passes that leave out rows without a gradient."""

import pytest
import torch

from diffstack_mmv.prediction.trajectron.recomputed import recomputed


class Counted:
    """A function of rows that tells how many it was given."""

    def __init__(self):
        self.scale = torch.tensor(1.5, dtype=torch.float64, requires_grad=True)
        self.seen = []

    def __call__(self, first, second):
        self.seen.append(len(first))
        product = self.scale * first * second.sum(-1, keepdim=True)
        return product.sin(), product.square().unsqueeze(-1)


@pytest.mark.parametrize("looked_at", [[], [2], [0, 3], [0, 1, 2, 3]])
def test_only_rows_with_a_gradient_are_evaluated_again(looked_at):
    function = Counted()
    rows = [torch.randn(4, 3, dtype=torch.float64, requires_grad=True) for _ in range(2)]
    weight = torch.zeros(4, 1, dtype=torch.float64)
    weight[looked_at] = 0.7

    def slopes(results):
        loss = (weight * results[0]).sum() + (weight * results[1][..., 0].exp()).sum()
        return torch.autograd.grad(loss, [*rows, function.scale])

    expected = slopes(function(*rows))
    function.seen.clear()
    found = slopes(recomputed(function, tuple(rows), [function.scale]))
    assert function.seen == [4, len(looked_at)]
    assert all(torch.allclose(*pair) for pair in zip(found, expected, strict=True))


def test_a_gradient_that_is_not_a_number_is_not_left_out():
    function = Counted()
    rows = tuple(torch.ones(2, 3, dtype=torch.float64, requires_grad=True) for _ in range(2))
    loss = recomputed(function, rows, [function.scale])[0][1].sum() * torch.nan
    assert torch.autograd.grad(loss, rows[0])[0][1].isnan().all()


def test_without_a_gradient_the_function_is_called_as_it_is():
    function = Counted()
    with torch.no_grad():
        result = recomputed(function, (torch.ones(2, 3), torch.ones(2, 3)), [function.scale])
    assert not result[0].requires_grad
    assert function.seen == [2]
