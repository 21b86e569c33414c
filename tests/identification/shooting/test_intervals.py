"""Shooting intervals."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from diffstack_mmv.identification.shooting.intervals import (
    interval_count,
    interval_length,
    join_intervals,
    node_times,
    split_intervals,
)


@given(stages=st.integers(1, 70), limit=st.integers(1, 80))
def test_segments_cover_the_track_and_none_is_too_long(stages, limit):
    segments = interval_count(stages, limit)
    length = interval_length(stages, segments)
    assert length <= limit
    assert (segments - 1) * length < stages <= segments * length


@given(stages=st.integers(1, 70), limit=st.integers(1, 80))
def test_cutting_and_connecting_changes_nothing(stages, limit):
    rows = torch.arange(2.0 * stages * 3).view(2, stages, 3)
    cut = split_intervals(rows, interval_count(stages, limit))
    assert torch.equal(join_intervals(cut, stages), rows)


@given(stages=st.integers(2, 70), limit=st.integers(1, 80))
def test_nodes_are_where_segments_begin(stages, limit):
    rows = torch.arange(float(stages)).view(1, stages)
    segments = interval_count(stages, limit)
    at_nodes = rows[:, node_times(stages, segments - 1)]
    assert torch.equal(at_nodes, split_intervals(rows, segments)[:, 1:, 0])


def test_track_without_a_limit_is_one_segment():
    assert interval_count(41, None) == 1
