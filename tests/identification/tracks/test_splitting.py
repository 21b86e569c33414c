"""Which segments are fitted, and which validate the fit."""

import pytest

from diffstack_mmv.identification import (
    DataSplit,
    RandomSelection,
    cross_validation_splits,
    split_segments,
)
from tests.identification.conftest import segment_along_circle
from tests.identification.tracks.conftest import circling, cut


def test_held_out_tracks_come_from_other_recordings():
    tracks = {f"track_{index}": circling(10.0) for index in range(8)}
    split = split_segments(cut(tracks), RandomSelection(), 10, 4, seed=1)
    assert split.fitted
    assert split.heldout
    assert not {e.recording for e in split.fitted} & {e.recording for e in split.heldout}


@pytest.mark.parametrize("parts_of", [None, {f"s{n}": f"ride {n // 2}" for n in range(6)}])
def test_agents_of_one_scene_and_scenes_of_one_recording_stay_together(parts_of):
    tracks = {f"s{number // 3}/agent_{number}": circling(10.0) for number in range(18)}
    segments = cut(tracks, parts_of=parts_of)
    split = split_segments(segments, RandomSelection(), 12, 4, seed=1)
    for part in (split, *cross_validation_splits(split, 3, seed=0)):
        scenes = [{each.name.partition("/")[0] for each in group} for group in part]
        rides = [{each.recording for each in group} for group in part]
        assert not scenes[0] & scenes[1]
        assert not rides[0] & rides[1]
    assert len({each.recording for each in segments}) == (3 if parts_of else 6)


def test_the_tracks_of_a_single_recording_are_kept_whole():
    segments = cut({f"a/agent_{number}": circling(20.0) for number in range(5)})
    split = split_segments(segments, RandomSelection(), 12, 4, seed=0)
    for fitted, heldout in (split, *cross_validation_splits(split, 2, seed=0)):
        assert min(len(fitted), len(heldout)) > 0
        assert not {each.track for each in fitted} & {each.track for each in heldout}


def test_single_recording_is_divided_by_its_segments():
    split = split_segments(cut({"a": circling(20.0)}), RandomSelection(), 3, 1, seed=0)
    names = {each.name for each in [*split.fitted, *split.heldout]}
    assert len(names) == len(split.fitted) + len(split.heldout) == 4


def test_same_seed_divides_alike_and_another_does_not():
    segments = cut({f"track_{index}": circling(10.0) for index in range(9)})
    first, again, other = (
        split_segments(segments, RandomSelection(), 8, 4, seed) for seed in (0, 0, 1)
    )
    names = [[each.name for each in split.fitted] for split in (first, again, other)]
    assert names[0] == names[1] != names[2]


def test_one_segment_cannot_be_divided():
    with pytest.raises(ValueError, match="`segments` must be at least 2"):
        split_segments(cut({"a": circling(5.0)}), RandomSelection(), 1, 1, seed=0)


@pytest.mark.parametrize("count", [2, 3, 9])
def test_each_segment_is_held_out_once_and_recordings_stay_together(count):
    every = [segment_along_circle(name, start) for name in "abcde" for start in (0, 5)]
    parts = cross_validation_splits(DataSplit(every[:6], every[6:]), count, seed=0)
    assert sorted(each.name for part in parts for each in part.heldout) == sorted(
        each.name for each in every
    )
    for part in parts:
        fitted, heldout = ({each.recording for each in group} for group in part)
        assert not fitted & heldout
        assert fitted


def test_a_single_recording_makes_no_folds():
    with pytest.raises(ValueError, match="`recordings` must be at least 2"):
        cross_validation_splits(
            DataSplit([segment_along_circle("a")], [segment_along_circle("a", 5)]), 2, seed=0
        )
