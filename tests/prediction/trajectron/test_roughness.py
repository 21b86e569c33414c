"""How noisy a track is, from its differences alone."""

import math

import pytest
import torch

from diffstack_mmv.geometry import rotate
from diffstack_mmv.prediction.trajectron.roughness import SMOOTH_M, USUAL_M, roughness
from tests.prediction.samples import DT_S, scene, trajectron

NONE = math.log(SMOOTH_M / USUAL_M)


def tracks_of(position):
    """Tracks `R H` with these positions in m, all of them valid."""
    count, rows = position.shape[:2]
    tracks = scene(batch=(count,), neighbors=0, history=rows, dtype=position.dtype).ego_past
    motion = tracks.motion._replace(position=position)
    return tracks._replace(motion=motion, valid=torch.ones_like(tracks.valid))


def circle(speed_mps=2.0, yaw_rate_radps=1.0, count=3, rows=41):
    angle = yaw_rate_radps * DT_S * torch.arange(rows, dtype=torch.float64)
    way = torch.stack([angle.sin(), 1 - angle.cos()], -1) * speed_mps / yaw_rate_radps
    return way.expand(count, -1, -1)


def noise(std_m, count=200, rows=41):
    drawn = torch.randn(count, rows, 2, generator=torch.Generator().manual_seed(0)).double()
    return std_m * drawn


@pytest.mark.parametrize("std_m", [0.01, 0.05, 0.2])
def test_white_noise_on_a_straight_way_is_found_in_both_differences(std_m):
    way = 0.3 * torch.arange(41, dtype=torch.float64)[:, None].expand(-1, 2)
    found = USUAL_M * roughness(tracks_of(way + noise(std_m))).exp()
    assert found.mean(0).tolist() == pytest.approx([std_m, std_m], rel=0.05)


def test_a_straight_way_without_noise_has_the_least_there_is():
    way = 0.3 * torch.arange(41, dtype=torch.float64)[:, None].expand(2, -1, 2)
    torch.testing.assert_close(roughness(tracks_of(way)), torch.full((2, 2), NONE).double())


def test_a_smooth_turn_is_in_the_third_differences_less_than_in_the_second():
    second, third = roughness(tracks_of(circle()))[0].tolist()
    assert second > NONE
    assert third < second - 1.0


def test_a_track_is_as_noisy_from_wherever_it_is_seen():
    positions = circle(count=200) + noise(0.03)
    seen = rotate(positions, torch.full(positions.shape[:2], 0.8).double()) + 100.0
    torch.testing.assert_close(roughness(tracks_of(seen)), roughness(tracks_of(positions)))


def test_what_is_not_valid_counts_for_nothing():
    tracks = tracks_of(circle() + noise(0.03, count=3))
    shorter = tracks_of(tracks.motion.position[:, 20:])
    valid = torch.arange(41).expand(3, -1) >= 20
    position = torch.where(valid[..., None], tracks.motion.position, 1e3)
    masked = tracks._replace(motion=tracks.motion._replace(position=position), valid=valid)
    torch.testing.assert_close(roughness(masked), roughness(shorter))


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_too_short_a_track_has_no_noise(rows):
    found = roughness(tracks_of(noise(1.0, count=2, rows=rows)))
    assert found.shape == (2, 2)
    assert found[:, 1].tolist() == pytest.approx([NONE, NONE])


@pytest.mark.parametrize("rough", [True, False])
def test_a_predictor_is_told_only_where_it_asks(rough):
    model = trajectron(rough=rough)
    plain = trajectron()
    assert (model.scene_encoder.outputs == plain.scene_encoder.outputs + 2) is rough
    forecast = model.predict(scene())
    assert all(field.isfinite().all() for field in forecast)
