"""How fast riders change their minds."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.signal import savgol_filter

from diffstack_mmv.identification import TrackingSettings, TrackSegment, estimate_rider_scales
from diffstack_mmv.identification.inference import rider_scales
from diffstack_mmv.identification.inference.rider_scales import rate_scales, thin_samples
from diffstack_mmv.identification.shooting.condensing import CondensedJacobian
from diffstack_mmv.identification.shooting.problem import Measurements, TrackingProblem, Unknowns
from tests.identification.conftest import segment_along_circle


def rides(jerk, curvature_rate, noise_m, count=8, steps=50, dt_s=0.1, smoothed=True):
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
        if smoothed:  # as converters do
            noise = torch.from_numpy(savgol_filter(noise, 9, 2, axis=0))
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


def test_every_sample_that_is_not_smoothed_tells_of_the_rider(bicycle):
    """Taken for a mean over half a second, each made riders seem several times as quick."""
    unsmoothed = rides(1.0, 0.1, 0.05, steps=75, dt_s=0.04, smoothed=False)
    found = estimate_rider_scales(TrackingSettings(0.05, 0.05), bicycle, unsmoothed, 0.04, False)
    assert found.jerk_mps3 == pytest.approx(1.0, rel=0.4)
    assert found.curvature_rate == pytest.approx(0.1, rel=0.4)


def test_tracks_that_no_rider_follows_leave_the_rates_as_they_were(bicycle, monkeypatch, caplog):
    """Their mean square was zero, and riders that never change anything were assumed."""
    infer = rider_scales.infer_controls

    def lost(*arguments):
        solution = infer(*arguments)
        return solution._replace(converged=torch.zeros_like(solution.converged))

    monkeypatch.setattr(rider_scales, "infer_controls", lost)
    settings = TrackingSettings(0.03, 0.03)
    found = estimate_rider_scales(settings, bicycle, rides(1.0, 0.1, 0.03, count=2), 0.1)
    assert found == settings
    assert "No track tells how fast its rider acts." in caplog.text


@pytest.mark.slow
def test_a_rider_that_never_changes_keeps_a_scale_above_zero(bicycle):
    found = estimate_rider_scales(
        TrackingSettings(0.05, 0.05), bicycle, rides(0.0, 0.0, 0.001, count=3), 0.1
    )
    assert 0.1 - 1e-9 <= found.jerk_mps3 < 1.0


@pytest.mark.usefixtures("unchecked")  # derivatives without a model
def test_a_scale_is_that_of_the_rates_that_the_tracks_determine():
    tracks, steps, rows = 3, 4, 10
    local, rates = torch.randn(tracks, rows, 6 + 2 * steps), torch.randn(tracks, steps, 2)
    jacobian = CondensedJacobian(
        local, torch.zeros(tracks, rows, 0), torch.zeros(tracks, rows), *(None, None, None)
    )
    simulator = SimpleNamespace(
        parameters=SimpleNamespace(start=lambda: None), jacobian=lambda *_, shared: jacobian
    )
    unknowns = Unknowns(torch.randn(tracks, 6), rates, torch.zeros(tracks, 0, 1))
    simulated = SimpleNamespace(residual=torch.randn(tracks, rows // 2, 2))
    converged = torch.tensor([True, False, True])
    solution = SimpleNamespace(unknowns=unknowns, simulated=simulated, converged=converged)
    squares, count = np.zeros(2), np.zeros(2)
    for index in (0, 2):
        hessian = local[index].numpy().T @ local[index].numpy() + np.eye(6 + 2 * steps)
        variance = np.diag(np.linalg.inv(hessian))[6:].reshape(steps, 2)
        squares += (rates[index].numpy() ** 2).sum(0)
        count += (1 - variance).sum(0)
    found = rate_scales(simulator, None, solution)
    assert found.tolist() == pytest.approx(np.sqrt(squares / count).tolist())


def test_one_of_several_samples_counts_in_every_track():
    weight = torch.tensor([[1.0] * 8, [1.0] * 5 + [0.0] * 3])
    nothing, plane = torch.zeros(2, 8, 0), torch.zeros(2, 8, 2)
    guess = Unknowns(torch.zeros(2, 6), torch.zeros(2, 7, 2), torch.zeros(2, 0, 4))
    measured = Measurements(plane, plane[..., 0], weight, nothing, nothing)
    thinned = thin_samples(TrackingProblem(measured, torch.zeros(2, 6), guess), 3)
    expected = [[1, 0, 0, 1, 0, 0, 1, 0], [1, 0, 0, 1, 0, 0, 0, 0]]
    assert thinned.measurements.weight.tolist() == expected
    assert thinned.measurements.position is plane


@pytest.mark.usefixtures("unchecked")  # no tracks are fitted
@pytest.mark.parametrize(
    ("ratios", "expected", "count"),
    [
        ([(2.0, 0.5), (1.5, 1.0), (1.01, 0.99), (5.0, 5.0)], (3.0 * 1.01, 0.5 * 0.99), 3),
        ([(1.0, 1.5), (1.0, 1.0)], (1.0, 1.5), 2),
        ([(0.01, 100.0)] * 20, (1 / 30, 30.0), 12),
    ],
    ids=["both", "one of them", "no further than a factor"],
)
def test_scales_change_by_their_ratios_until_none_changes(
    bicycle, monkeypatch, ratios, expected, count
):
    tried, each = [], iter(ratios)

    def model_of(model, settings):
        tried.append(settings)
        return original(model, settings)

    original = rider_scales.TrackingModel
    monkeypatch.setattr(rider_scales, "TrackingModel", model_of)
    monkeypatch.setattr(rider_scales, "infer_controls", lambda *_: None)
    monkeypatch.setattr(rider_scales, "rate_scales", lambda *_: torch.tensor(next(each)))
    given = TrackingSettings(
        0.05, 0.02, 4.0, 0.3, control_noise=(0.1, 0.2), steer_rate_radps=0.4, segment_steps=5
    )
    found = estimate_rider_scales(given, bicycle, [segment_along_circle("a")], 0.1)
    assert len(tried) == count
    assert found.jerk_mps3 == pytest.approx(4.0 * expected[0])
    assert found.curvature_rate == pytest.approx(0.3 * expected[1])
    # five samples of 0.1 s count as one, with the noise of their mean
    for settings in tried:
        assert settings.along_m == pytest.approx(0.05 / math.sqrt(5))
        assert settings.across_m == pytest.approx(0.02 / math.sqrt(5))
        assert settings.control_noise is settings.steer_rate_radps is settings.segment_steps is None
    assert (found.along_m, found.across_m) == (0.05, 0.02)
    assert (found.control_noise, found.segment_steps) == ((0.1, 0.2), 5)
    assert found.steer_rate_radps == 0.4
