"""Which segments are preferred."""

import pytest
import torch

from diffstack_mmv.identification import ExcitationSelection, LongestSelection
from tests.identification.tracks.conftest import circling, cut


@pytest.mark.parametrize(
    ("choice", "best"), [(LongestSelection(), "fast"), (ExcitationSelection(), "turning")]
)
def test_choice_prefers(choice, best):
    tracks = {
        "fast": circling(6.0, 8.0),
        "turning": circling(6.0, 3.0, 0.8),
        "dull": circling(6.0, 2.0),
    }
    segments = cut(tracks)
    scores = choice(segments, torch.Generator().manual_seed(0))
    assert segments[int(scores.argmax())].recording == best
