"""Augmentations keep a batch physical and repeat with their generator."""

import pytest
import torch
from torch.utils._pytree import tree_flatten

from diffstack_mmv.data import (
    Chain,
    Mirror,
    PositionNoise,
    RecordingNoise,
    Rotation,
    SpeedScale,
    stack_batch,
)
from diffstack_mmv.data.motions import STANDSTILL_MPS
from diffstack_mmv.geometry import position_from_frame, rotate, wrap_angle

CHAIN = Chain([Mirror(0.5), Rotation(0.3), SpeedScale()])
DT_S = 0.1
EVERY = [
    Mirror(0.5),
    Rotation(0.3),
    SpeedScale(),
    PositionNoise(),
    RecordingNoise(0.05, DT_S),
    CHAIN,
]


@pytest.fixture
def batch(source, windows):
    opened = source.open("train", windows)
    return stack_batch(opened.get_collate_fn()([opened[i] for i in range(0, 120, 4)]), windows)


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def tensors(batch):
    return [part for part in tree_flatten(batch)[0] if isinstance(part, torch.Tensor)]


def joined(batch):
    """Position, heading, velocity and yaw rate of the ego over past and future."""
    past, future = batch.ego_past.motion, batch.ego_future.motion
    return [torch.cat([a, b], 1) for a, b in zip(past, future, strict=True)]


@pytest.mark.parametrize("augmentation", EVERY, ids=lambda a: type(a).__name__)
def test_the_generator_alone_decides(batch, augmentation):
    first, second = (tensors(augmentation(batch, generator())) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))
    other = tensors(augmentation(batch, generator(1)))
    assert not all(torch.equal(a, b) for a, b in zip(first, other, strict=True))


@pytest.mark.parametrize("augmentation", EVERY, ids=lambda a: type(a).__name__)
def test_absent_rows_stay_zero_and_the_input_is_untouched(batch, augmentation):
    before = [part.clone() for part in tensors(batch)]
    changed = augmentation(batch, generator())
    assert all(torch.equal(a, b) for a, b in zip(before, tensors(batch), strict=True))
    for tracks in (changed.ego_past, changed.neighbors_past, changed.neighbors_future):
        for part in tracks.motion:
            assert (part[~tracks.valid] == 0).all()
            assert part.isfinite().all()


@pytest.mark.parametrize("augmentation", [Mirror(1.0), Rotation(0.5), SpeedScale(0.5, 2.0)])
def test_velocity_and_yaw_rate_remain_the_derivatives_of_the_track(batch, augmentation):
    position, heading, velocity, rate = joined(augmentation(batch, generator()))
    world = rotate(velocity, heading)[:, 1:-1]
    torch.testing.assert_close(position[:, 2:] - position[:, :-2], 0.2 * world, atol=2e-3, rtol=0)
    turned = wrap_angle(heading[:, 2:] - heading[:, :-2])
    torch.testing.assert_close(turned, 0.2 * rate[:, 1:-1], atol=1e-4, rtol=0)


def test_mirroring_twice_changes_nothing(batch):
    twice = Chain([Mirror(1.0), Mirror(1.0)])(batch, generator())._replace(frame=batch.frame)
    assert all(torch.equal(a, b) for a, b in zip(tensors(batch), tensors(twice), strict=True))


@pytest.mark.parametrize("augmentation", [Mirror(1.0), SpeedScale()], ids=["mirrored", "scaled"])
def test_the_world_has_no_place_that_looks_like_a_changed_sample(batch, augmentation):
    assert batch.frame.known.all()
    assert not augmentation(batch, generator()).frame.known.any()


@pytest.mark.parametrize("augmentation", [Mirror(0.5), SpeedScale(0.8, 1.2, probability=0.5)])
def test_samples_that_are_left_as_they_are_know_their_place(batch, augmentation):
    changed = augmentation(batch, generator())
    same = torch.stack(
        [
            (after == before).flatten(1).all(-1)
            for after, before in zip(changed.ego_past.motion, batch.ego_past.motion, strict=True)
        ]
    ).all(0)
    assert torch.equal(changed.frame.known, same)
    assert 0.2 < same.float().mean() < 0.8


@pytest.mark.parametrize("augmentation", [Mirror(1.0), SpeedScale()])
def test_samples_without_a_frame_are_scaled_and_mirrored_as_well(augmentation, batch):
    changed = augmentation(batch._replace(frame=None), generator())
    assert changed.frame is None
    assert torch.equal(changed.goal, augmentation(batch, generator()).goal)


def test_a_turned_frame_leaves_the_agents_where_they_are_in_the_world(batch):
    def in_the_world(given):
        frame = given.frame
        return position_from_frame(
            given.ego_future.motion.position, frame.position[:, None], frame.heading[:, None]
        )

    turned = Rotation(0.5)(batch, generator())
    assert (turned.frame.heading - batch.frame.heading).abs().max() > 0.1
    torch.testing.assert_close(in_the_world(turned), in_the_world(batch))


def test_a_mirrored_neighbor_changes_sides(batch):
    mirrored = Mirror(1.0)(batch, generator()).neighbors_past.motion
    torch.testing.assert_close(
        mirrored.position[..., 1], -batch.neighbors_past.motion.position[..., 1]
    )
    assert torch.equal(mirrored.velocity[..., 0], batch.neighbors_past.motion.velocity[..., 0])


@pytest.mark.parametrize("augmentation", EVERY, ids=lambda a: type(a).__name__)
def test_the_goal_remains_the_end_of_the_future(batch, augmentation):
    changed = augmentation(batch, generator())
    assert torch.equal(changed.goal, changed.ego_future.motion.position[:, -1])


@pytest.mark.parametrize("std_m", [0.02, 0.1])
def test_noise_moves_the_observed_past_but_neither_the_present_nor_the_future(batch, std_m):
    noisy = PositionNoise(std_m)(batch, generator())
    moved = noisy.ego_past.motion.position - batch.ego_past.motion.position
    assert moved[:, :-1].std().item() == pytest.approx(std_m, rel=0.1)
    assert (moved[:, -1] == 0).all()
    assert torch.equal(noisy.goal, batch.goal)


def test_noise_on_part_of_the_samples_leaves_the_others_as_they_are(batch):
    noisy = PositionNoise(0.05, probability=0.5)(batch, generator())
    moved = noisy.ego_past.motion.position - batch.ego_past.motion.position
    sizes = moved[:, :-1].flatten(1).std(-1)
    assert 0.2 < (sizes > 0).float().mean() < 0.8
    assert sizes[sizes > 0].mean().item() == pytest.approx(0.05, rel=0.1)


def differentiated(batch):
    """A batch whose past has velocities as `smoother=none` makes them, and headings along them."""

    def derived(tracks):
        step = tracks.motion.position.diff(dim=-2) / DT_S
        velocity = torch.cat([step[..., :1, :], step], -2) * tracks.valid[..., None]
        heading = torch.atan2(velocity[..., 1], velocity[..., 0])
        motion = tracks.motion._replace(heading=heading, velocity=rotate(velocity, -heading))
        return tracks._replace(motion=motion)

    return batch._replace(
        ego_past=derived(batch.ego_past), neighbors_past=derived(batch.neighbors_past)
    )


@pytest.mark.parametrize("past", ["ego_past", "neighbors_past"])
def test_velocities_of_a_noisy_recording_are_the_steps_between_its_positions(batch, past):
    noisy = getattr(RecordingNoise(0.05, DT_S)(differentiated(batch), generator()), past)
    both = noisy.valid[..., 1:] & noisy.valid[..., :-1]
    step = noisy.motion.position.diff(dim=-2) / DT_S
    velocity = rotate(noisy.motion.velocity, noisy.motion.heading)[..., 1:, :]
    torch.testing.assert_close(velocity[both], step[both], atol=1e-4, rtol=1e-4)
    assert both.any()


def test_a_velocity_is_as_sure_as_before_where_the_step_to_it_is_missing(batch):
    batch = differentiated(batch)
    valid = batch.ego_past.valid.clone()
    valid[:, 5] = False
    before = batch.ego_past._replace(valid=valid)
    noisy = RecordingNoise(0.05, DT_S)(batch._replace(ego_past=before), generator()).ego_past
    old, new = (rotate(each.motion.velocity, each.motion.heading) for each in (before, noisy))
    assert torch.allclose(new[:, 6], old[:, 6], atol=1e-5)
    assert not torch.allclose(new[:, 7], old[:, 7], atol=1e-2)


def test_who_moves_in_a_noisy_recording_faces_where_it_goes(batch):
    noisy = RecordingNoise(0.05, DT_S)(differentiated(batch), generator()).ego_past.motion
    moving = noisy.velocity.norm(dim=-1) > STANDSTILL_MPS
    assert moving.any()
    assert noisy.velocity[moving][:, 1].abs().max() < 1e-5
    assert (noisy.velocity[moving][:, 0] > 0).all()


def test_who_stands_in_a_noisy_recording_keeps_its_heading(batch):
    past = batch.ego_past
    still = past.motion._replace(
        position=torch.zeros_like(past.motion.position),
        velocity=torch.zeros_like(past.motion.velocity),
        heading=torch.full_like(past.motion.heading, 0.7),
    )
    batch = batch._replace(ego_past=past._replace(motion=still))
    noisy = RecordingNoise(0.005, DT_S)(batch, generator()).ego_past.motion
    assert noisy.velocity.norm(dim=-1).max() < STANDSTILL_MPS
    torch.testing.assert_close(noisy.heading, still.heading)
    assert (noisy.yaw_rate == 0).all()


def test_a_noisy_recording_has_a_present_like_the_rest_and_the_future_of_before(batch):
    noisy = RecordingNoise(0.05, DT_S)(batch, generator())
    moved = noisy.ego_past.motion.position - batch.ego_past.motion.position
    sizes = moved.flatten(1).std(-1)
    assert 0.015 < sizes.mean() < 0.035
    assert sizes.max() < 0.06
    assert (moved[:, -1] != 0).all()
    futures = zip(noisy.ego_future.motion, batch.ego_future.motion, strict=True)
    assert all(torch.equal(a, b) for a, b in futures)


def test_a_recording_is_noisy_in_part_of_the_samples_alone(batch):
    noisy = RecordingNoise(0.05, DT_S, probability=0.5)(batch, generator()).ego_past.motion
    same = torch.stack(
        [(a == b).flatten(1).all(-1) for a, b in zip(noisy, batch.ego_past.motion, strict=True)]
    )
    assert torch.equal(same.all(0), same.any(0))
    assert 0.2 < same.all(0).float().mean() < 0.8


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        (lambda: Mirror(2.0), "`probability` must lie in"),
        (lambda: Rotation(0.0), "`limit_rad` must be positive"),
        (lambda: SpeedScale(1.2, 0.9), "`high` must be at least 1.2"),
        (lambda: SpeedScale(probability=1.5), "`probability` must lie in"),
        (lambda: PositionNoise(-1.0), "`std_m` must be positive"),
        (lambda: RecordingNoise(0.0, 0.1), "`most_m` must be positive"),
        (lambda: RecordingNoise(0.05, 0.0), "`dt_s` must be positive"),
        (lambda: RecordingNoise(0.05, 0.1, 1.5), "`probability` must lie in"),
    ],
)
def test_impossible_augmentations_are_refused(wrong, complaint):
    with pytest.raises(ValueError, match=complaint):
        wrong()
