"""How fast riders change their minds."""

import pytest
import torch
from scipy.signal import savgol_filter

from diffstack_mmv.identification import TrackingSettings, TrackSegment, estimate_rider_scales


def rides(jerk, curvature_rate, noise_m, count=8, steps=50, dt_s=0.1):
    """Unicycles whose acceleration and curvature walk at random."""
    generator = torch.Generator().manual_seed(0)
    scale = dt_s * torch.tensor([jerk, curvature_rate])
    rides = []
    for index in range(count):
        walk = (scale * torch.randn(steps + 1, 2, generator=generator)).cumsum(0)
        speed = (6.0 + dt_s * walk[:, 0].cumsum(0)).clamp_min(2.0)
        course = dt_s * (speed * walk[:, 1]).cumsum(0)
        way = dt_s * (speed.unsqueeze(-1) * torch.stack([course.cos(), course.sin()], -1))
        noise = noise_m * torch.randn(steps + 1, 2, generator=generator)
        noise = torch.from_numpy(savgol_filter(noise, 9, 2, axis=0))  # as converters smooth it
        rides.append(TrackSegment(f"{index}@0s", way.cumsum(0) + noise, course, speed))
    return rides


@pytest.mark.parametrize(
    ("jerk", "curvature_rate"), [(1.0, 0.1), pytest.param(2.0, 0.04, marks=pytest.mark.slow)]
)
def test_scales_of_a_known_rider_are_found_from_elsewhere(bicycle, jerk, curvature_rate):
    settings = TrackingSettings(0.03, 0.03)
    found = estimate_rider_scales(settings, bicycle, rides(jerk, curvature_rate, 0.03), 0.1)
    assert found.jerk_mps3 == pytest.approx(jerk, rel=0.35)
    assert found.curvature_rate == pytest.approx(curvature_rate, rel=0.35)
    assert found.along_m == settings.along_m


@pytest.mark.slow
def test_a_rider_that_never_changes_keeps_a_scale_above_zero(bicycle):
    found = estimate_rider_scales(
        TrackingSettings(0.05, 0.05), bicycle, rides(0.0, 0.0, 0.001, count=3), 0.1
    )
    assert 0.1 - 1e-9 <= found.jerk_mps3 < 1.0
