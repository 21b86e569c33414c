"""Roots and directions to the last digit."""

import numpy as np
import pytest
import torch

from diffstack_mmv.geometry import length, root, unit_vector


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_root_is_correctly_rounded(dtype, scale):
    square = torch.rand(20_000, dtype=dtype) * scale
    assert np.array_equal(root(square).numpy(), np.sqrt(square.numpy()))


def test_root_of_zero_infinity_and_negative_numbers_follows_the_standard():
    values = root(torch.tensor([0.0, torch.inf, -1.0], dtype=torch.float64))
    assert values[0] == 0
    assert values[1] == torch.inf
    assert values[2].isnan()


def test_length_equals_the_norm_of_numpy():
    vectors = torch.randn(2_000, 2, dtype=torch.float64)
    expected = [np.linalg.norm(vector) for vector in vectors.numpy()]
    assert np.allclose(length(vectors).numpy(), expected, rtol=3e-16, atol=0)


def test_unit_vector_equals_the_functions_of_numpy():
    angle = 20 * torch.rand(5_000, dtype=torch.float64) - 10
    x, y = unit_vector(angle).numpy().T
    assert np.allclose(x, np.cos(angle.numpy()), rtol=0, atol=2e-16)
    assert np.allclose(y, np.sin(angle.numpy()), rtol=0, atol=2e-16)
