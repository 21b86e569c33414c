"""Local models: the curvature of the dynamics, exact and by differences of the exact gradient."""

import pytest
import torch

from diffstack_mmv.control.chunked import PAIRS, Chunked, pull
from diffstack_mmv.control.expansion import (
    assemble,
    differenced_curvature,
    dynamics_curvature,
    expand_by_differences,
    value_along,
)
from tests.control.problems import goal_cost, rate_model


def pairs(dtype):
    """States, controls and costates of two problems and five times."""
    generator = torch.Generator().manual_seed(0)
    shapes = (2, 5, 4), (2, 5, 2), (2, 5, 4)
    return [torch.randn(shape, generator=generator, dtype=dtype) for shape in shapes]


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-2), (torch.float64, 1e-6)])
def test_differenced_curvature_has_half_of_the_digits_of_the_exact_one(dtype, tolerance):
    arguments = rate_model(1.2), *pairs(dtype)
    exact, differenced = dynamics_curvature(*arguments), differenced_curvature(*arguments)
    for one, other in zip(exact, differenced, strict=True):
        assert (one - other).abs().max() <= tolerance * one.abs().max().clamp_min(1)


def test_curvature_is_the_hessian_of_the_weighted_step():
    states, controls, costates = pairs(torch.float64)
    model = rate_model(1.2)

    def weighted(both):
        return (costates[0, 0] * model(both[:4], both[4:])).sum()

    expected = torch.func.hessian(weighted)(torch.cat([states[0, 0], controls[0, 0]]))
    found = dynamics_curvature(model, states, controls, costates)
    torch.testing.assert_close(found.xx[0, 0], expected[:4, :4])
    torch.testing.assert_close(found.ux[0, 0], expected[4:, :4])
    torch.testing.assert_close(found.uu[0, 0], expected[4:, 4:])


@pytest.mark.parametrize("share", [0.0, 0.7, 1.0])
def test_a_local_model_in_chunks_equals_the_one_in_one_call(share):
    generator = torch.Generator().manual_seed(0)
    x, u = (
        torch.randn(shape, generator=generator, dtype=torch.float64)
        for shape in ((6, 4, 300), (5, 2, 300))
    )
    dynamics, like = rate_model(1.2), torch.zeros(300, dtype=torch.float64)
    goal, weight = torch.ones(300, 2, dtype=torch.float64), torch.tensor([0.2, 0.05, 0.5])
    near = torch.rand(300, generator=generator) < share
    arguments = dynamics, goal_cost(goal, weight), like, x, u, near
    whole = expand_by_differences(*arguments)
    in_chunks = Chunked(pull, value_along, assemble)(*arguments)
    assert x[:-1].numel() > 2 * PAIRS
    torch.testing.assert_close(in_chunks, whole, rtol=1e-6, atol=1e-6)
