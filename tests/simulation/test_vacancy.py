"""A place among discs is found, or shown not to be there."""

import numpy as np
import pytest

from diffstack_mmv.simulation.vacancy import FINEST_M, Taken, may_have_place


def square(centers, half_m):
    """Places within 2 m of the origin in both directions."""
    return (abs(centers) - half_m <= 2.0).all(-1)


def covering(spacing_m, radius_m):
    """Discs on a lattice over the square and beyond."""
    line = np.arange(-3, 3 + spacing_m / 2, spacing_m)
    center = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
    return Taken(center, np.full(len(center), radius_m))


def test_where_discs_cover_everything_there_is_no_place():
    reach = 0.5 * np.sqrt(0.5)  # of discs that meet in the middle of four
    assert not may_have_place(square, covering(0.5, reach + 1e-3), 2.0)
    assert may_have_place(square, covering(0.5, reach - 2 * FINEST_M), 2.0)


@pytest.mark.parametrize("hole_m", [0.3, 0.02, 0.002])
def test_one_small_hole_is_found(hole_m):
    center = np.array([1.234, -0.567])
    others = covering(0.5, 0.6)
    away = np.linalg.norm(others.center - center, axis=-1)
    taken = Taken(others.center, np.minimum(others.radius, away - hole_m / 2))
    assert may_have_place(square, taken, 2.0)
    assert not may_have_place(square, others, 2.0)


def test_a_place_beside_the_region_is_none():
    """Only what can be drawn counts: the corner of a disc's box is free, and beyond the region."""
    taken = Taken(np.zeros((1, 2)), np.array([2.1 * np.sqrt(2)]))
    assert not may_have_place(square, taken, 4.0)


def test_the_room_at_a_place_is_the_distance_to_the_nearest_disc():
    taken = Taken(np.array([(0.0, 0.0)]), np.array([1.0]))
    both = taken.and_of(Taken(np.array([(3.0, 4.0)]), np.array([0.5])))
    assert both.room(np.array([(0.0, 2.0), (3.0, 4.0)])).tolist() == pytest.approx([1.0, -0.5])
