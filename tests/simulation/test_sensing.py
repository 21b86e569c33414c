"""What a robot sees of the pedestrians, and what a tracker makes of it."""

from dataclasses import fields

import pytest
import torch

from diffstack_mmv.simulation import CircleCrossing, LimitedSensing, PedestrianTracker
from diffstack_mmv.simulation.pedestrians.base import PedestrianHistory
from diffstack_mmv.simulation.views import FAR
from dmmv_conventions.configs import config_folder
from dmmv_conventions.yaml_files import load_plain


@pytest.fixture
def seen(world_with):
    """The start of a crossing; the robot stands at (0, -4) and looks north."""
    world = world_with()
    return world.observe(world.start(CircleCrossing(humans=5).cases("train", (0, 1))))


def test_without_limits_everything_is_seen_as_it_is(seen):
    assert LimitedSensing()(seen) is seen


@pytest.mark.parametrize(("range_m", "view_deg"), [(3.0, 360.0), (None, 90.0), (5.0, 180.0)])
def test_who_is_far_or_out_of_view_is_hidden_far_away(seen, range_m, view_deg):
    told = LimitedSensing(range_m, view_deg)(seen)
    offset = seen.pedestrian_position - seen.motion.position[:, None]
    near = offset.norm(dim=-1) - 0.6 <= (range_m or 1e9)
    off_course = (torch.atan2(offset[..., 1], offset[..., 0]) - torch.pi / 2).cos().acos()
    expected = near & (off_course <= torch.deg2rad(torch.tensor(view_deg / 2)))
    assert torch.equal(told.seen, expected)
    assert 0 < int(expected.sum()) < expected.numel()
    assert torch.equal(told.pedestrian_position[expected], seen.pedestrian_position[expected])
    assert (told.pedestrian_position[~expected].norm(dim=-1) > 500).all()


def test_a_limited_sensor_tells_nothing_of_before_the_start(seen):
    shape = seen.pedestrian_position.shape[:-1]
    history = PedestrianHistory(
        torch.zeros(*shape, 3, 2), torch.zeros(*shape, 3, 2), torch.ones(*shape, 3).bool(), 0.25
    )
    recorded = seen._replace(history=history)
    assert LimitedSensing(3.0)(recorded).history is None
    assert LimitedSensing()(recorded).history is history


def test_hidden_people_are_within_the_observation_space(seen):
    twenty = seen.pedestrian_position[:, :1].expand(-1, 20, -1) + 100.0
    crowd = {
        "pedestrian_position": twenty,
        "pedestrian_velocity": torch.zeros_like(twenty),
        "pedestrian_radius": torch.full(twenty.shape[:-1], 0.3).double(),
        "seen": torch.ones(twenty.shape[:-1]).bool(),
    }
    told = LimitedSensing(5.0)(seen._replace(**crowd))
    assert not told.seen.any()
    assert told.pedestrian_position.abs().max() < FAR


def test_noise_has_its_deviation_and_repeats(seen):
    sensing = LimitedSensing(position_noise_m=0.2, seed=3)
    first, again = sensing(seen), sensing(seen)
    assert torch.equal(first.pedestrian_position, again.pedestrian_position)
    error = first.pedestrian_position - seen.pedestrian_position
    assert 0.05 < float(error.std()) < 0.4
    assert torch.equal(first.pedestrian_velocity, seen.pedestrian_velocity)


def test_a_tracker_halves_the_error_and_remembers_who_was_lost(seen):
    tracker, tracked, errors = PedestrianTracker(position_m=0.2, velocity_mps=0.2), None, []
    velocity = torch.ones_like(seen.pedestrian_velocity) * 0.7
    generator = torch.Generator().manual_seed(0)
    for step in range(12):
        truth = seen.pedestrian_position + 0.25 * step * velocity
        noise = 0.2 * torch.randn(2, *truth.shape, generator=generator, dtype=truth.dtype)
        told = seen._replace(
            pedestrian_position=truth + noise[0],
            pedestrian_velocity=velocity + noise[1],
            seen=seen.seen & (step < 8),
            time=seen.time + 0.25 * step,
        )
        tracked = tracker(tracked, told)
        believed = tracker.believed(tracked, told)
        errors.append(float((believed.pedestrian_position - truth).norm(dim=-1).mean()))
        assert bool(believed.seen.all())
    assert errors[7] < 0.7 * errors[0]
    assert errors[11] < 0.6


def test_who_was_never_seen_stays_unseen(seen):
    tracker = PedestrianTracker(memory_s=0.5)
    hidden = seen._replace(seen=torch.zeros_like(seen.seen))
    tracked = tracker(tracker(None, hidden), hidden._replace(time=hidden.time + 0.25))
    assert not tracker.believed(tracked, hidden).seen.any()


@pytest.mark.parametrize("path", sorted((config_folder() / "sensing").glob("*.yaml")))
def test_every_setting_of_a_sensor_can_be_given_on_the_command_line(path):
    told = set(load_plain(path.read_text(encoding="utf-8"))) - {"_target_"}
    assert told == {each.name for each in fields(LimitedSensing)}


@pytest.mark.parametrize(
    ("view_deg", "needs"),
    [(0.0, "be positive"), (-90.0, "be positive"), (400.0, "be at most a whole turn, 360, but")],
)
def test_a_field_of_view_is_an_angle_up_to_a_whole_turn(view_deg, needs):
    with pytest.raises(ValueError, match=f"`view_deg` must {needs}"):
        LimitedSensing(view_deg=view_deg)
