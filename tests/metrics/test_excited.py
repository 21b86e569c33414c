"""Speed and lateral acceleration of the recorded human."""

import pytest
import torch

from diffstack_mmv.metrics import LATERAL, SPEED, excitation
from diffstack_mmv.types import Motion
from tests.prediction.samples import at_rest, scene


def on_a_circle(speed, rate, batch=2, history=21, horizon=30, dt_s=0.1):
    """The ego of every sample on a circle of that speed (m/s) and yaw rate (rad/s)."""
    given = scene(batch=(batch,), history=history, horizon=horizon)

    def ride(tracks, first):
        time = dt_s * (first + torch.arange(tracks.valid.shape[-1]))
        radius = speed / rate
        path = torch.stack([(rate * time).sin(), 1 - (rate * time).cos()], -1) * radius
        motion = tracks.motion._replace(position=path.expand_as(tracks.motion.position))
        return tracks._replace(motion=Motion(*motion))

    past, future = ride(given.ego_past, 1 - history), ride(given.ego_future, 1)
    return given._replace(ego_past=past, ego_future=future)


@pytest.mark.parametrize(("speed", "rate"), [(4.0, 0.5), (4.0, -0.5), (8.0, 0.3), (2.0, 1.0)])
def test_a_circle_is_ridden_at_its_speed_and_lateral_acceleration(speed, rate):
    found = excitation(on_a_circle(speed, rate))
    assert torch.allclose(found[SPEED], torch.full((2,), speed), rtol=0.02)
    assert torch.allclose(found[LATERAL], torch.full((2,), abs(speed * rate)), rtol=0.03)


@pytest.mark.parametrize("name", [SPEED, LATERAL])
def test_whoever_stands_has_none(name):
    assert excitation(at_rest(scene(batch=(3,), horizon=30)))[name].tolist() == [0.0] * 3


def test_what_was_not_recorded_does_not_count():
    batch = on_a_circle(4.0, 0.5)
    far = batch.ego_future.motion.position.clone()
    far[:, 10:] = 1e6
    valid = batch.ego_future.valid.clone()
    valid[:, 10:] = False
    future = batch.ego_future._replace(
        motion=batch.ego_future.motion._replace(position=far), valid=valid
    )
    assert excitation(batch._replace(ego_future=future))[SPEED].max() < 4.1


def test_a_horizon_of_one_step_has_no_acceleration():
    found = excitation(scene(batch=(2,), horizon=1))
    assert torch.isfinite(found[SPEED]).all()
    assert found[LATERAL].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("speed", [0.2, 0.4])
def test_the_slower_than_walking_the_less_lateral_acceleration_counts(speed):
    """Below half a metre per second, in proportion."""
    found = excitation(on_a_circle(speed, 0.5))
    expected = torch.full((2,), 0.5 * speed * speed / 0.5)
    assert torch.allclose(found[LATERAL], expected, rtol=0.03)


def along_chords(dt_s=0.1):
    """The ego at 3 m/s straight on, as seen every half second from now on; noise in between."""
    given = scene(batch=(2,), horizon=30)
    way = 3.0 * dt_s * torch.arange(31.0)
    path = torch.stack([way, torch.zeros(31)], -1).expand(2, 31, 2).clone()
    between = torch.arange(31) % 5 != 0
    path[:, between] += torch.randn(2, int(between.sum()), 2)
    past = given.ego_past.motion.position.clone()
    past[:, -1] = path[:, 0]
    ego = [
        tracks._replace(motion=tracks.motion._replace(position=position))
        for tracks, position in ((given.ego_past, past), (given.ego_future, path[:, 1:]))
    ]
    return given._replace(ego_past=ego[0], ego_future=ego[1])


def test_noise_between_the_ends_of_half_seconds_is_no_excitation():
    found = excitation(along_chords())
    assert torch.allclose(found[SPEED], torch.tensor(3.0))
    assert found[LATERAL].max() < 1e-4


@pytest.mark.parametrize("row", [5, 10, 15, 30])
def test_no_chord_reaches_over_a_time_that_was_not_recorded(row):
    batch = along_chords()
    future = batch.ego_future
    future.motion.position[:, row - 1] = torch.tensor([40.0, 40.0])
    future.valid[:, row - 1] = False
    found = excitation(batch)
    assert torch.allclose(found[SPEED], torch.tensor(3.0))
    assert found[LATERAL].max() < 1e-4
