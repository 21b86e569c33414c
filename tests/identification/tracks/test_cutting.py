"""Cutting recorded tracks into segments."""

import math

import pytest
import torch

from diffstack_mmv.identification import SegmentSettings
from tests.identification.tracks.conftest import circling, cut


def stopped_in_the_middle():
    motion = circling(10.0)
    motion.velocity[48:52] = 0
    return motion


def test_segments_do_not_overlap_and_keep_clear_of_the_ends():
    segments = cut({"a": circling(12.0)})
    starts = [each.name for each in segments]
    assert starts == ["a@0.5s", "a@4.6s", "a@8.7s"]
    assert [len(each.speed) for each in segments] == [41, 41, 29]


def test_standstill_ends_a_segment():
    segments = cut({"a": stopped_in_the_middle()})
    assert [each.name for each in segments] == ["a@0.5s", "a@5.2s"]


def test_course_has_no_jumps():
    (segment, *_) = cut({"a": circling(6.0, yaw_rate=2.0)})
    torch.testing.assert_close(segment.course.diff(), torch.full((40,), 0.2))


def test_measured_lean_travels_with_its_segment():
    lean = torch.arange(61.0)
    (segment, *_) = cut({"a": circling(6.0)}, leans={"a": lean})
    torch.testing.assert_close(segment.lean, lean[5:46])


def test_where_controls_are_asked_for_segments_have_them_all_along():
    controls = torch.zeros(len(circling(12.0).heading), 2)
    controls[:30] = torch.nan
    tracks = {"a": circling(12.0), "b": circling(12.0)}
    segments = cut(tracks, controls={"a": controls})
    assert {each.recording for each in segments} == {"a"}
    assert all(bool(each.controls.isfinite().all()) for each in segments)


@pytest.mark.parametrize(
    ("tracks", "beside", "told"),
    [
        ({}, {}, "`motions` must hold at least one track"),
        ({"a": circling(1.5)}, {}, "`tracks` must hold a segment of 2 s above 1 m/s.*Lower"),
        ({"a": circling(12.0)}, {"controls": {}}, "hold a segment .* with recorded controls"),
        ({"a": circling(6.0)}, {"controls": {"a": torch.zeros(60, 2)}}, "have 61 rows,.*got 60"),
        ({"a": circling(6.0)}, {"leans": {"a": torch.zeros(62)}}, "have 61 rows,.*got 62 for"),
        ({"a": circling(6.0)}, {"leans": {"b": torch.zeros(61)}}, "`leans` must be of tracks"),
    ],
)
def test_tracks_that_cannot_be_cut_are_refused(tracks, beside, told):
    with pytest.raises(ValueError, match=told):
        cut(tracks, **beside)


def with_step(motion, dt_s):
    """The motion, as somebody would hand it over who sampled it every dt_s seconds."""
    return motion._replace(position=motion.position * dt_s / 0.1)


@pytest.mark.parametrize(
    ("motion", "told"),
    [
        (
            with_step(circling(6.0), 0.2),
            "move as their velocities say .* of 0.1 s, but got 2 times",
        ),
        (with_step(circling(6.0), 0.05), "but got 0.5 times as far along them. Give their step"),
        (circling(6.0)._replace(heading=torch.full((61,), 90.0)), "in m/s, and radians"),
    ],
    ids=["every 0.2 s", "every 0.05 s", "degrees"],
)
def test_tracks_that_do_not_move_as_they_say_are_refused(motion, told):
    with pytest.raises(ValueError, match=told):
        cut({"a": motion})


def test_noise_of_positions_is_no_other_step():
    motion = circling(20.0, speed=1.1)
    noise = 0.2 * torch.randn(201, 2, generator=torch.Generator().manual_seed(0))
    assert cut({"a": motion._replace(position=motion.position + noise)})


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("noise", [0.1, (0.1,), (0.1, 0.1, 0.1)])
def test_a_noise_that_is_no_pair_is_refused(noise):
    with pytest.raises(ValueError, match="`noise_m` must be a pair in m, along and across"):
        cut({"a": circling(6.0)}, noise_m=noise)


def test_segments_without_an_end_are_refused():
    with pytest.raises(ValueError, match="`max_s` must be positive, but got inf"):
        SegmentSettings(max_s=math.inf)
