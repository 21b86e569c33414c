"""A small identification and its summary."""

import pytest
import torch

from diffstack_mmv.identification import (
    FittedMotion,
    IdentifiabilityThresholds,
    Identifier,
    TrackSegment,
    summarise,
)
from tests.identification.conftest import double_precision, synthetic_problem


@pytest.fixture(scope="module")
def result():
    with double_precision():
        setup = synthetic_problem("kbm", {"wheelbase": 1.15})
        found = Identifier(starts=0)(setup.simulator, setup.data)
    return setup, found, summarise(setup.simulator, setup.data, found, IdentifiabilityThresholds())


def leaning(model, measured):
    """A motion along a line with these leans."""
    time = torch.arange(len(measured)).double()
    line = torch.stack([time, time], -1)
    segment = TrackSegment("a@0.0s", line, time, time, None, measured)
    return FittedMotion(segment, line, line[1:], model)
