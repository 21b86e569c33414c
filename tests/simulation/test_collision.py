"""Clearances against dense sampling of the motion."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from diffstack_mmv.simulation import DiscFootprint, RectangleFootprint
from diffstack_mmv.simulation.collision import (
    ClosestApproach,
    distance_box_to_segment,
    distance_to_segment,
)
from diffstack_mmv.vehicles import load_vehicle

SAMPLES = torch.linspace(0, 1, 2001, dtype=torch.float64)[:, None, None]


def random_segments(count):
    return torch.randn(2, count, 2, dtype=torch.float64).unbind()


def approach_of(start, end, heading=0.0, radius=0.3):
    each = torch.ones_like(start[..., 0])
    return ClosestApproach(start, end, radius * each, heading * each, heading * each)


BOX = torch.tensor((0.9, 0.3), dtype=torch.float64)


@pytest.mark.parametrize(
    ("distance", "half", "off"),
    [
        (distance_to_segment, torch.zeros(2, dtype=torch.float64), 2e-3),
        (lambda start, end: distance_box_to_segment(BOX, start, end), BOX, 3e-3),
    ],
    ids=["of a point", "of a box"],
)
def test_distance_to_a_segment_equals_the_smallest_sampled_one(distance, half, off):
    start, end = random_segments(300)
    points = start + SAMPLES * (end - start)
    sampled = (points.abs() - half).clamp(min=0).norm(dim=-1).amin(dim=0)
    assert torch.allclose(distance(start, end), sampled, atol=off)


def test_distance_to_a_segment_without_length_is_that_to_the_point():
    start, _ = random_segments(10)
    assert torch.allclose(distance_to_segment(start, start), start.norm(dim=-1))


@pytest.mark.parametrize("end", [(5.0, 0.0), (0.0, 5.0), (-4.0, 0.0)])
def test_a_segment_through_the_box_has_distance_zero(end):
    start = -torch.tensor([end], dtype=torch.float64)
    half = torch.tensor((0.9, 0.3), dtype=torch.float64)
    assert distance_box_to_segment(half, start, -start) == 0


def test_discs_that_pass_between_two_instants_are_noticed():
    start, end = torch.tensor([[-3.0, 0.1]]).double(), torch.tensor([[3.0, 0.1]]).double()
    clearance = DiscFootprint(0.3).clearance(approach_of(start, end))
    assert torch.allclose(clearance, torch.tensor([-0.5]).double())


@pytest.mark.parametrize(
    ("place", "heading", "reach_m"),
    [([2.0, 0.0], 0.0, 0.9), ([0.0, 2.0], 0.0, 0.3), ([0.0, 2.0], math.pi / 2, 0.9)],
    ids=["ahead", "aside", "turned to the side"],
)
def test_a_long_rectangle_reaches_further_ahead_than_aside(place, heading, reach_m):
    away = torch.tensor(place).double()
    footprint = RectangleFootprint(length_m=1.8, width_m=0.6)
    clearance = footprint.clearance(approach_of(away, away, heading=heading))
    assert math.isclose(clearance, 2.0 - reach_m - 0.3)


def test_the_disc_around_a_rectangle_never_has_more_clearance():
    start, end = random_segments(300)
    approach = approach_of(3 * start, 3 * end, heading=0.7)
    rectangle = RectangleFootprint(length_m=1.8, width_m=0.6)
    around = DiscFootprint(rectangle.radius_m).clearance(approach)
    assert (around <= rectangle.clearance(approach) + 1e-12).all()


def test_a_rectangle_ahead_of_its_reference_point_turns_around_that():
    footprint = RectangleFootprint(length_m=1.8, width_m=0.6, ahead_m=0.5)
    ahead, behind = torch.tensor([[2.0, 0.0], [-2.0, 0.0]]).double()
    assert footprint.clearance(approach_of(ahead, ahead)) == pytest.approx(2.0 - 1.4 - 0.3)
    assert footprint.clearance(approach_of(behind, behind)) == pytest.approx(2.0 - 0.4 - 0.3)
    turned = footprint.clearance(approach_of(ahead, ahead, heading=math.pi))
    assert turned == pytest.approx(2.0 - 0.4 - 0.3)


def test_a_disc_is_its_own_cover():
    ahead, radius = DiscFootprint(0.4).discs()
    assert (ahead.tolist(), radius.tolist()) == ([0.0], [0.4])


SIZES = st.floats(0.2, 4.0)


@given(SIZES, SIZES, st.floats(-1.0, 1.0), st.floats(-1, 1), st.floats(-1, 1))
def test_discs_cover_every_point_of_the_rectangle(length, width, offset, along, across):
    ahead, radius = RectangleFootprint(length, width, offset).discs()
    point = torch.tensor([offset + 0.5 * length * along, 0.5 * width * across]).double()
    distance = torch.stack([ahead - point[0], point[1].expand_as(ahead)]).norm(dim=0)
    assert (distance <= radius + 1e-9).any()


@given(SIZES, SIZES)
def test_discs_are_few_equal_and_stand_out_little(length, width):
    ahead, radius = RectangleFootprint(length, width).discs()
    assert len(ahead) <= 5
    assert (radius == radius[0]).all()
    assert ahead.sum().abs() < 1e-9
    if length <= 5 * width:
        assert radius[0] - 0.5 * width <= 0.21 * width
        fewer = len(ahead) - 1
        # one disc less would stand out further
        assert fewer == 0 or 0.5 * math.hypot(length / fewer, width) > 0.7071 * width


@pytest.mark.parametrize(("vehicle", "count"), [("bicycle", 3), ("cart", 2), ("hoverboard", 1)])
def test_vehicles_are_covered_by_few_discs(vehicle, count):
    size = load_vehicle(vehicle).footprint
    assert len(RectangleFootprint(size.length_m, size.width_m).discs().ahead) == count


@pytest.mark.parametrize(
    "footprint",
    [DiscFootprint(0.4), RectangleFootprint(1.8, 0.6), RectangleFootprint(1.8, 0.6, 0.525)],
)
def test_the_outline_is_where_the_clearance_of_a_point_vanishes(footprint):
    corners = footprint.outline()
    clearance = footprint.clearance(approach_of(corners, corners, radius=0.0))
    assert torch.allclose(clearance, torch.zeros_like(clearance), atol=1e-7)
    assert corners.norm(dim=-1).max() == pytest.approx(footprint.radius_m)


@pytest.mark.parametrize(
    ("footprint", "area"),
    [
        (DiscFootprint(0.4), 24 * 0.4**2 * math.sin(2 * math.pi / 48)),
        (RectangleFootprint(1.8, 0.6, 0.525), 1.8 * 0.6),
    ],
)
def test_the_outline_runs_once_around_the_area_counter_clockwise(footprint, area):
    x, y = footprint.outline().unbind(-1)
    found = 0.5 * (x * y.roll(-1) - x.roll(-1) * y).sum().item()
    assert found == pytest.approx(area)


@pytest.mark.parametrize("size", [0.0, -1.0, math.nan, math.inf])
def test_a_footprint_without_size_is_refused(size):
    with pytest.raises(ValueError, match="`radius_m` must be positive"):
        DiscFootprint(size)
    with pytest.raises(ValueError, match="`width_m` must be positive"):
        RectangleFootprint(1.0, size)
