"""Segments of different lengths in one batch."""

import pytest
import torch

from diffstack_mmv.identification import stack_segments
from tests.identification.tracks.conftest import circling, cut


def test_shorter_segments_are_padded_and_marked():
    segments = cut({"a": circling(12.0)})
    whole = stack_segments(segments)
    assert whole.samples.tolist() == [41, 41, 29]
    assert not bool(whole.valid[2, 29:].any())
    torch.testing.assert_close(whole.position[2, 29:], whole.position[2, 28].expand(12, 2))


def test_positions_that_are_not_finite_are_refused():
    segments = cut({"a": circling(6.0)})
    segments[0].position[3] = torch.nan
    with pytest.raises(ValueError, match="`tracks` must be finite, but got NaN.*a@0.5s"):
        stack_segments(segments)
