"""Repairs of scenes of trajdata's own data sets."""

import numpy as np
import pandas as pd
import pytest

from diffstack_mmv.data import HeldHeading, UpwardY


def scene(**columns):
    index = pd.MultiIndex.from_tuples([("a", i) for i in range(4)] + [("b", i) for i in range(2)])
    return pd.DataFrame(columns, index=index, dtype=float)


def test_a_heading_is_held_at_standstill_within_each_agent():
    rows = scene(vx=[0, 2, 0, 0, 0, 0], vy=[0] * 6, heading=[9, 1, 0, 0, 5, 6])
    HeldHeading().apply(rows)
    assert rows["heading"].tolist() == [9, 1, 1, 1, 5, 6]


@pytest.mark.parametrize("later", [1.0, -2.0])
def test_who_has_not_moved_yet_does_not_know_where_it_will_go(later):
    rows = scene(vx=[0, 0, 0, 2, 0, 0], vy=[0] * 6, heading=[3, 3, 3, later, 5, 6])
    HeldHeading().apply(rows)
    assert rows["heading"].tolist() == [3, 3, 3, later, 5, 6]


def test_turning_y_up_turns_a_right_turn_into_a_left_turn():
    rows = scene(y=[1.0] * 6, vy=[2.0] * 6, ay=[3.0] * 6, heading=[0.5] * 6)
    UpwardY().apply(rows)
    np.testing.assert_allclose(rows.to_numpy(), [[-1.0, -2.0, -3.0, -0.5]] * 6)


@pytest.mark.parametrize("speed", [0.0, -0.4, float("nan")])
def test_a_standstill_speed_must_be_positive(speed):
    with pytest.raises(ValueError, match="`standstill_mps` must be positive"):
        HeldHeading(speed)
