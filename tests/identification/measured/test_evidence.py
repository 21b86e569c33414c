"""Instruments that a fit tells of."""

from dataclasses import replace

import pytest
import torch

from diffstack_mmv.identification.measured.evidence import LearnedInstruments, heard_noise
from diffstack_mmv.identification.measured.instruments import (
    OF_FREEWHEEL,
    OF_RECORDING,
    Gaussian,
    InstrumentPriors,
    MeasurementNoise,
)
from tests.identification.measured.test_rollout_report import windows_of

GIVEN = MeasurementNoise()


def heard_by(recording, gyro):
    """Windows whose gyro says so while the fit stands still."""
    zero = [0.0] * len(recording)
    windows = windows_of(zero, zero, recording=recording)._replace(yaw_rate=gyro)
    return heard_noise(windows, torch.zeros_like(gyro), GIVEN)


@pytest.mark.parametrize("recording", [(0, 0, 0), (1,)])
def test_a_single_recording_says_nothing_about_the_bias_of_recordings(recording):
    gyro = torch.randn(len(recording), 50, dtype=torch.float64)
    assert heard_by(recording, gyro) is GIVEN


def test_windows_without_a_gyro_are_not_heard():
    gyro = torch.randn(3, 50, dtype=torch.float64)
    gyro[1:] = torch.nan
    assert heard_by((0, 1, 2), gyro) is GIVEN


@pytest.mark.parametrize("std", [0.01, 0.2])
def test_white_noise_of_the_gyro_is_heard_as_it_is(std):
    torch.manual_seed(0)
    bias = torch.tensor([[0.1], [0.3]], dtype=torch.float64)
    found = heard_by((0, 1), bias + std * torch.randn(2, 4000, dtype=torch.float64))
    assert found.yaw_rate_radps == pytest.approx(std, rel=0.1)
    assert found.yaw_rate_bias.mean == pytest.approx(0.2, abs=0.02)
    assert replace(found, yaw_rate_radps=0.04, yaw_rate_bias=GIVEN.yaw_rate_bias) == GIVEN


def test_errors_that_last_weigh_as_more_white_noise():
    torch.manual_seed(0)
    white = torch.randn(2, 4000, dtype=torch.float64)
    lasting = white.unfold(-1, 4, 1).mean(-1) * 2  # the same deviation, but over four steps
    assert heard_by((0, 1), lasting).yaw_rate_radps > 1.3 * heard_by((0, 1), white).yaw_rate_radps


def learned(coasting):
    """Two recordings with a window each."""
    scale = torch.tensor([[0.1, 1.2, 0.9, 0.0], [0.3, 1.4, 1.1, 0.2]])
    return LearnedInstruments(
        InstrumentPriors(), scale, torch.full((2, len(OF_RECORDING)), 1e-6),
        torch.ones(2, len(OF_FREEWHEEL)), torch.full((2, len(OF_FREEWHEEL)), 1e-6),
        torch.tensor(coasting), torch.tensor([0, 1]),
    )  # fmt: skip


def test_what_no_window_showed_keeps_its_prior():
    found = learned([False, False]).priors(torch.tensor([False, False]))
    for name in OF_FREEWHEEL:
        assert getattr(found, name) == getattr(InstrumentPriors(), name)
    assert found.coasting_share == InstrumentPriors().coasting_share


@pytest.mark.parametrize(
    ("left_out", "offset", "share"), [((0, 0), 0.2, 0.5), ((1, 0), 0.3, 0.0), ((0, 1), 0.1, 1.0)]
)
def test_priors_are_of_the_recordings_that_are_not_left_out(left_out, offset, share):
    found = learned([True, False]).priors(torch.tensor(left_out).bool())
    assert found.steer_offset.mean == pytest.approx(offset)
    expected = InstrumentPriors().coasting_share if share == 0 else share
    assert found.coasting_share == pytest.approx(expected)


def test_the_mean_of_the_steering_scales_is_the_gain_and_stays_at_its_prior():
    found = learned([True, True]).priors(torch.tensor([False, False]))
    assert found.steer_scale == Gaussian(
        InstrumentPriors().steer_scale.mean, pytest.approx(0.1, rel=1e-3)
    )
