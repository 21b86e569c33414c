"""Matrices with the batch last equal those with the batch first."""

import pytest
import torch

from diffstack_mmv.control.batch_last import (
    apply,
    from_batch_last,
    pack,
    product,
    symmetric,
    to_batch_last,
    transposed_apply,
    transposed_product,
    unpack,
    walk,
)


def drawn(*shape):
    return torch.randn(shape, dtype=torch.float64)


P, Q, R, V, W = ((3, 4, 7), (4, 2, 7), (3, 2, 7), (4, 7), (3, 7))
EQUAL = {
    "PQ": (product, (P, Q), "xyN,yzN->xzN"),
    "P'R": (transposed_product, (P, R), "yxN,yzN->xzN"),
    "Pv": (apply, (P, V), "abN,bN->aN"),
    "P'w": (transposed_apply, (P, W), "baN,bN->aN"),
}


@pytest.mark.parametrize("name", EQUAL)
def test_products_are_those_of_each_problem(name):
    function, shapes, formula = EQUAL[name]
    factors = [drawn(*shape) for shape in shapes]
    torch.testing.assert_close(function(*factors), torch.einsum(formula, *factors))


def test_the_symmetric_part_has_the_same_quadratic_form():
    matrix, vector = drawn(4, 4, 7), drawn(4, 7)
    even = symmetric(matrix)
    assert torch.equal(even, even.transpose(0, 1))
    forms = [(vector * apply(each, vector)).sum(0) for each in (even, matrix)]
    torch.testing.assert_close(*forms)


def test_unpacking_undoes_packing():
    parts = [drawn(3, 3, 7), drawn(3, 7), drawn(1, 2, 7)]
    found = unpack(pack(*parts), (3, 3), (3,), (1, 2))
    assert all(torch.equal(one, other) for one, other in zip(found, parts, strict=True))


@pytest.mark.parametrize("batch", [(), (1,), (5,), (2, 3)])
@pytest.mark.parametrize("rows", [(), (4,), (4, 2)])
def test_the_batch_comes_back_from_the_last_dimension(batch, rows):
    tensor, like = drawn(*batch, *rows), drawn(*batch)
    moved = to_batch_last(tensor, like)
    assert moved.shape == (*rows, like.numel())
    assert torch.equal(from_batch_last(moved, like), tensor)


@pytest.mark.parametrize("reverse", [False, True])
def test_a_walk_hands_its_value_on_and_keeps_the_order_of_time(reverse):
    inputs = drawn(6, 1, 2)

    def added(carry, row):
        return carry + row, carry + row

    end, sums = walk(added, torch.zeros(1, 2).double(), inputs, reverse)
    expected = inputs.flip(0).cumsum(0).flip(0) if reverse else inputs.cumsum(0)
    torch.testing.assert_close(sums, expected)
    torch.testing.assert_close(end, inputs.sum(0))
