"""Agreement of leans."""

import pytest
import torch

from diffstack_mmv.identification import lean_agreement
from tests.identification.report.conftest import leaning


def test_lean_agreement_leaves_out_what_was_not_measured():
    model = torch.tensor([0.1, 0.2, 0.3, 0.4])
    measured = torch.tensor([torch.nan, 0.1, 0.2, 0.3])
    told = lean_agreement([leaning(model, measured)], 0.1, 0.1)
    assert told["samples"] == 3
    assert told["rms_difference_rad"] == pytest.approx(0.1)
    assert told["correlation"] == pytest.approx(1.0)
    assert lean_agreement([leaning(None, measured)], 0.1) is None


@pytest.mark.parametrize("late", [0, 3, 7])
def test_a_late_lean_is_told_by_how_much(late):
    time_s = 0.1 * torch.arange(80).double()
    wave = torch.sin(2.0 * time_s) + torch.sin(0.7 * time_s)
    told = lean_agreement([leaning(wave.roll(late), wave)] * 2, 0.1)
    assert told["late_s"] == pytest.approx(0.1 * late)
    assert told["correlation_late"] > 0.99


WAVE, LEVEL = torch.linspace(-0.1, 0.3, 30).double(), torch.zeros(30).double()


@pytest.mark.parametrize(("model", "measured"), [(WAVE, LEVEL), (LEVEL, WAVE)])
def test_a_lean_that_does_not_vary_has_no_correlation(model, measured):
    told = lean_agreement([leaning(model, measured)], 0.1)
    assert (told["correlation"], told["correlation_late"], told["late_s"]) == (None, None, None)
    assert told["rms_difference_rad"] == pytest.approx(float(WAVE.square().mean().sqrt()))


def test_a_lean_that_was_measured_elsewhere_alone_tells_nothing():
    assert lean_agreement([leaning(WAVE, LEVEL * torch.nan)], 0.1) is None
