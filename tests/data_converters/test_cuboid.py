"""Size and axis of vehicles from their 12 edges."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_converters import RejectReason, TrackError
from data_converters.imptc.cuboid import measure_cuboids
from data_converters.imptc.sample.sensor import cuboid_edges


@given(
    st.floats(-np.pi, np.pi),
    st.floats(2.5, 12.0),
    st.floats(0.8, 2.4),
    st.floats(1.2, 3.5),
    st.integers(0, 99),
)
def test_size_and_axis_come_back_whatever_the_order_of_the_edges(
    angle, length, width, height, seed
):
    edges = cuboid_edges(np.array([3.0, -7.0, 0.2]), angle, (length, width, height))
    edges = np.random.default_rng(seed).permutation(edges)
    box = measure_cuboids([edges.tolist()], "here")
    np.testing.assert_allclose(np.ravel(box[:3]), (length, width, height), atol=0.01)
    turned = (box.axis[0] - angle + np.pi / 2) % np.pi - np.pi / 2
    assert abs(turned) < 0.01


def test_every_sample_has_a_size_and_an_axis_of_its_own():
    sizes, angles = [(4.0, 2.0, 1.5), (9.0, 2.2, 3.0), (4.0, 1.8, 1.5)], [0.1, 1.4, 2.9]
    boxes = [
        cuboid_edges(np.ones(3), angle, size) for angle, size in zip(angles, sizes, strict=True)
    ]
    found = measure_cuboids([box.tolist() for box in boxes], "here")
    np.testing.assert_allclose(np.stack(found[:3], 1), sizes, atol=1e-6)
    np.testing.assert_allclose(found.axis, angles, atol=1e-6)


@pytest.mark.parametrize("angle", np.arange(0.1, 3.0, 0.1))
@pytest.mark.parametrize("size", [(4.0, 0.0, 1.5), (4.0, 2.0, 0.0), (4.0, 0.09, 1.5)])
def test_what_is_flat_is_no_cuboid_however_it_lies(angle, size):
    with pytest.raises(TrackError, match="`cuboid` must be 12 edges"):
        measure_cuboids([cuboid_edges(np.array([3.0, -7.0, 0.2]), angle, size).tolist()], "file")


@pytest.mark.parametrize(
    "edges",
    [
        None,
        [],
        [[1, 2]],
        np.zeros((12, 2, 3)).tolist(),
        np.full((12, 2, 3), np.nan).tolist(),
        "text",
        np.random.default_rng(0).normal(size=(12, 2, 3)).tolist(),
        (cuboid_edges(np.zeros(3), 0.3, (4.0, 2.0, 1.5)) * np.array([1.0, 0.0, 1.0])).tolist(),
    ],
)
def test_what_is_no_cuboid_is_refused_with_its_file(edges):
    with pytest.raises(TrackError, match="`cuboid`.*in file") as caught:
        measure_cuboids([edges], "file")
    assert caught.value.reason is RejectReason.BROKEN_CUBOID
