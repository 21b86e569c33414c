"""Sines that treat each entry by itself have the values of the usual ones."""

import math

import pytest
import torch

from diffstack_mmv.control.separate_lanes import FAST, SINES, SeparateLanes, separate


def found(sine, angle):
    return separate(lambda function, *parts: function(*parts), sine, angle, FAST[angle.dtype])


@pytest.mark.parametrize("dtype", FAST)
@pytest.mark.parametrize("sine", SINES)
def test_small_angles_give_the_same_bits(sine, dtype):
    angle = torch.cat([torch.linspace(-14, 14, 999, dtype=dtype), torch.tensor([0.0, -0.0])])
    assert found(sine, angle).equal(sine(angle))


@pytest.mark.parametrize("dtype", FAST)
@pytest.mark.parametrize("sine", SINES[:2])
def test_large_angles_are_reduced_to_the_precision_of_the_angle(sine, dtype):
    angle = torch.linspace(-2000, 2000, 999, dtype=dtype)
    exact = sine(angle.double()) if dtype == torch.float32 else sine(angle)
    error = (found(sine, angle) - exact).abs()
    assert (error <= 2 * torch.finfo(dtype).eps * (1 + angle.abs())).all()


@pytest.mark.parametrize("sine", SINES)
def test_what_is_not_finite_gives_nan_and_no_digits_give_a_finite_number(sine):
    assert found(sine, torch.tensor([math.nan, math.inf, -math.inf])).isnan().all()
    assert found(sine, torch.tensor([1e20, -3e38])).isfinite().all()


def test_a_graph_has_no_other_sines_left():
    def swing(angle):
        return torch.ops.aten.sin.default(angle) * torch.ops.aten.exp.default(angle)

    angle = torch.tensor([0.5, 300.0, math.nan])
    graph = torch.fx.symbolic_trace(swing).graph
    for node in graph.nodes:
        node.meta["val"] = angle
    SeparateLanes()(graph)
    graph.lint()
    changed = torch.fx.GraphModule(torch.nn.Module(), graph)
    assert "where" in changed.code
    torch.testing.assert_close(changed(angle), swing(angle), equal_nan=True, rtol=1e-4, atol=0)
