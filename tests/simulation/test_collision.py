"""Clearances against dense sampling of the motion."""

import math

import pytest
import torch

from diffstack_mmv.simulation import DiscFootprint, RectangleFootprint
from diffstack_mmv.simulation.collision import (
    Approach,
    distance_box_to_segment,
    distance_to_segment,
)

SAMPLES = torch.linspace(0, 1, 2001, dtype=torch.float64)[:, None, None]


def random_segments(count):
    return torch.randn(2, count, 2, dtype=torch.float64).unbind()


def approach_of(start, end, heading=0.0, radius=0.3):
    each = torch.ones_like(start[..., 0])
    return Approach(start, end, radius * each, heading * each, heading * each)


def test_distance_to_a_segment_equals_the_smallest_sampled_one():
    start, end = random_segments(200)
    sampled = (start + SAMPLES * (end - start)).norm(dim=-1).amin(dim=0)
    assert torch.allclose(distance_to_segment(start, end), sampled, atol=2e-3)


def test_distance_to_a_segment_without_length_is_that_to_the_point():
    start, _ = random_segments(10)
    assert torch.allclose(distance_to_segment(start, start), start.norm(dim=-1))


def test_distance_of_a_box_equals_the_smallest_sampled_one():
    start, end = random_segments(300)
    half = torch.tensor((0.9, 0.3), dtype=torch.float64)
    points = start + SAMPLES * (end - start)
    sampled = (points.abs() - half).clamp(min=0).norm(dim=-1).amin(dim=0)
    assert torch.allclose(distance_box_to_segment(half, start, end), sampled, atol=3e-3)


@pytest.mark.parametrize("end", [(5.0, 0.0), (0.0, 5.0), (-4.0, 0.0)])
def test_a_segment_through_the_box_has_distance_zero(end):
    start = -torch.tensor([end], dtype=torch.float64)
    half = torch.tensor((0.9, 0.3), dtype=torch.float64)
    assert distance_box_to_segment(half, start, -start) == 0


def test_discs_that_pass_between_two_instants_are_noticed():
    start, end = torch.tensor([[-3.0, 0.1]]).double(), torch.tensor([[3.0, 0.1]]).double()
    clearance = DiscFootprint(0.3).clearance(approach_of(start, end))
    assert torch.allclose(clearance, torch.tensor([-0.5]).double())


def test_a_long_rectangle_reaches_further_ahead_than_aside():
    ahead, aside = torch.tensor([[2.0, 0.0], [0.0, 2.0]]).double()
    footprint = RectangleFootprint(length_m=1.8, width_m=0.6)
    assert math.isclose(footprint.clearance(approach_of(ahead, ahead)), 2.0 - 0.9 - 0.3)
    assert math.isclose(footprint.clearance(approach_of(aside, aside)), 2.0 - 0.3 - 0.3)


def test_the_rectangle_turns_with_the_heading():
    aside = torch.tensor([0.0, 2.0]).double()
    footprint = RectangleFootprint(length_m=1.8, width_m=0.6)
    clearance = footprint.clearance(approach_of(aside, aside, heading=math.pi / 2))
    assert math.isclose(clearance, 2.0 - 0.9 - 0.3)


def test_the_disc_around_a_rectangle_never_has_more_clearance():
    start, end = random_segments(300)
    approach = approach_of(3 * start, 3 * end, heading=0.7)
    rectangle = RectangleFootprint(length_m=1.8, width_m=0.6)
    around = DiscFootprint(rectangle.radius_m).clearance(approach)
    assert (around <= rectangle.clearance(approach) + 1e-12).all()


@pytest.mark.parametrize("footprint", [DiscFootprint(0.4), RectangleFootprint(1.8, 0.6)])
def test_the_outline_is_where_the_clearance_of_a_point_vanishes(footprint):
    corners = footprint.outline()
    clearance = footprint.clearance(approach_of(corners, corners, radius=0.0))
    assert torch.allclose(clearance, torch.zeros_like(clearance), atol=1e-7)
    assert corners.norm(dim=-1).max() == pytest.approx(footprint.radius_m)


@pytest.mark.parametrize("size", [0.0, -1.0, math.nan, math.inf])
def test_a_footprint_without_size_is_refused(size):
    with pytest.raises(ValueError, match="`radius_m` must be positive"):
        DiscFootprint(size)
    with pytest.raises(ValueError, match="`width_m` must be positive"):
        RectangleFootprint(1.0, size)
