"""Which parts of tracks are used, and by whom."""

import pytest
import torch

from diffstack_mmv.identification import (
    ExcitingChoice,
    LongestChoice,
    RandomChoice,
    StretchSettings,
    batch,
    cut,
    divide,
)
from diffstack_mmv.types import Motion

SETTINGS = StretchSettings(min_s=2.0, max_s=4.0, trim_s=0.5)


def circling(seconds, speed=3.0, yaw_rate=0.0):
    time = 0.1 * torch.arange(round(seconds * 10) + 1)
    heading = torch.remainder(yaw_rate * time + torch.pi, 2 * torch.pi) - torch.pi
    step = 0.1 * speed * torch.stack([heading.cos(), heading.sin()], -1)
    velocity = torch.stack([torch.full_like(time, speed), torch.zeros_like(time)], -1)
    return Motion(step.cumsum(0), heading, velocity, torch.full_like(time, yaw_rate))


def stopped_in_the_middle():
    motion = circling(10.0)
    motion.velocity[48:52] = 0
    return motion


def test_stretches_do_not_overlap_and_keep_clear_of_the_ends():
    stretches = cut({"a": circling(12.0)}, SETTINGS)
    starts = [each.name for each in stretches]
    assert starts == ["a@0.5s", "a@4.6s", "a@8.7s"]
    assert [len(each.speed) for each in stretches] == [41, 41, 29]


def test_standstill_ends_a_stretch():
    stretches = cut({"a": stopped_in_the_middle()}, SETTINGS)
    assert [each.name for each in stretches] == ["a@0.5s", "a@5.2s"]


def test_course_has_no_jumps():
    (stretch, *_) = cut({"a": circling(6.0, yaw_rate=2.0)}, SETTINGS)
    torch.testing.assert_close(stretch.course.diff(), torch.full((40,), 0.2))


def test_measured_lean_travels_with_its_stretch():
    lean = torch.arange(61.0)
    (stretch, *_) = cut({"a": circling(6.0)}, SETTINGS, {"a": lean})
    torch.testing.assert_close(stretch.lean, lean[5:46])


def test_tracks_too_short_are_refused_with_a_remedy():
    with pytest.raises(ValueError, match="`tracks` must hold a stretch of 2 s above 1 m/s.*Lower"):
        cut({"a": circling(1.5)}, SETTINGS)


def test_shorter_stretches_are_padded_and_marked():
    stretches = cut({"a": circling(12.0)}, SETTINGS)
    whole = batch(stretches)
    assert whole.samples.tolist() == [41, 41, 29]
    assert not bool(whole.valid[2, 29:].any())
    torch.testing.assert_close(whole.position[2, 29:], whole.position[2, 28].expand(12, 2))


def test_positions_that_are_not_finite_are_refused():
    stretches = cut({"a": circling(6.0)}, SETTINGS)
    stretches[0].position[3] = torch.nan
    with pytest.raises(ValueError, match="`tracks` must be finite, but got NaN.*a@0.5s"):
        batch(stretches)


@pytest.mark.parametrize(
    ("choice", "best"), [(LongestChoice(), "fast"), (ExcitingChoice(), "turning")]
)
def test_choice_prefers(choice, best):
    tracks = {
        "fast": circling(6.0, 8.0),
        "turning": circling(6.0, 3.0, 0.8),
        "dull": circling(6.0, 2.0),
    }
    stretches = cut(tracks, SETTINGS)
    scores = choice(stretches, torch.Generator().manual_seed(0))
    assert stretches[int(scores.argmax())].recording == best


def test_held_out_tracks_come_from_other_recordings():
    tracks = {f"track_{index}": circling(10.0) for index in range(8)}
    division = divide(cut(tracks, SETTINGS), RandomChoice(), 10, 4, seed=1)
    assert division.fitted
    assert division.heldout
    assert not {e.recording for e in division.fitted} & {e.recording for e in division.heldout}


def test_single_recording_is_divided_by_its_stretches():
    division = divide(cut({"a": circling(20.0)}, SETTINGS), RandomChoice(), 3, 1, seed=0)
    names = {each.name for each in [*division.fitted, *division.heldout]}
    assert len(names) == len(division.fitted) + len(division.heldout) == 4


def test_same_seed_divides_alike_and_another_does_not():
    stretches = cut({f"track_{index}": circling(10.0) for index in range(9)}, SETTINGS)
    first, again, other = (divide(stretches, RandomChoice(), 8, 4, seed) for seed in (0, 0, 1))
    names = [[each.name for each in division.fitted] for division in (first, again, other)]
    assert names[0] == names[1] != names[2]


def test_one_stretch_cannot_be_divided():
    with pytest.raises(ValueError, match="`stretches` must be at least 2"):
        divide(cut({"a": circling(5.0)}, SETTINGS), RandomChoice(), 1, 1, seed=0)


def test_where_controls_are_asked_for_stretches_have_them_all_along():
    controls = torch.zeros(len(circling(12.0).heading), 2)
    controls[:30] = torch.nan
    tracks = {"a": circling(12.0), "b": circling(12.0)}
    stretches = cut(tracks, SETTINGS, controls={"a": controls})
    assert {each.recording for each in stretches} == {"a"}
    whole = batch(stretches).controls
    assert whole is not None
    assert bool(whole.isfinite().all())


def test_tracks_without_controls_where_they_are_asked_for_are_refused():
    with pytest.raises(ValueError, match="`tracks` must hold a stretch .* with recorded controls"):
        cut({"a": circling(12.0)}, SETTINGS, controls={})
