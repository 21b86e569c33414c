"""Functions whose last digit counts: correctly rounded, whatever vector library torch was built on.

A benchmark case is decided by comparisons and goes on for a hundred steps, so that an error of one
unit in the last place may change its end. Products and sums are exact to the digit everywhere;
roots, cosines and sines of torch need not be.
"""

import torch
from jaxtyping import Float
from torch import Tensor

SPLIT = 2.0**27 + 1
"""Splits a float64 number into two halves whose products are exact."""


def root(square: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Correctly rounded square root, NaN below zero.

    One Newton step in float64 with the residual x - s² computed without rounding error.

    Source:
        Dekker, A floating-point technique for extending the available precision (1971).
    """
    wide = square.double()
    guess = torch.sqrt(wide)
    scaled = guess * SPLIT
    high = scaled - (scaled - guess)
    low = guess - high
    product = guess * guess
    error = ((high * high - product) + 2 * high * low) + low * low
    residual = (wide - product) - error
    refined = guess + residual / (2 * guess)
    return torch.where((guess > 0) & refined.isfinite(), refined, guess).to(square.dtype)


def length(vector: Float[Tensor, "*b 2"]) -> Float[Tensor, "*b"]:
    """Length of a planar vector, in the unit of the vector."""
    x, y = vector.unbind(dim=-1)
    return root(x * x + y * y)


def unit_vector(angle: Float[Tensor, "*b"]) -> Float[Tensor, "*b 2"]:
    """The vector (cos, sin) of an angle in rad, with the accuracy of the C library."""
    return torch.view_as_real(torch.polar(torch.ones_like(angle), angle))
