"""What can be wrong with a source, and what is said about it."""

import json

import pytest

from diffstack_mmv.data import ConvertedCache, NamedDataset, WindowSettings


def broken(cache, tmp_path, **changes):
    state = json.loads((cache / "toy" / "cache.json").read_text()) | changes
    (tmp_path / "toy").mkdir()
    (tmp_path / "toy" / "cache.json").write_text(json.dumps(state))
    return ConvertedCache("toy", str(tmp_path))


def test_a_missing_cache_tells_how_to_make_it(tmp_path):
    with pytest.raises(ValueError, match="no such file.*scripts/convert.py data=toy"):
        ConvertedCache("toy", str(tmp_path)).identity()


def test_a_half_converted_cache_is_told_apart(tmp_path):
    (tmp_path / ".converting_toy_12").mkdir()
    with pytest.raises(ValueError, match="interrupted conversion"):
        ConvertedCache("toy", str(tmp_path)).open("train", WindowSettings())


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"format_version": 7}, "`format_version` must be 1, but got 7"),
        ({"complete": False}, "`complete` must be true"),
    ],
)
def test_a_cache_of_another_state_is_refused(cache, tmp_path, change, complaint):
    with pytest.raises(ValueError, match=complaint):
        broken(cache, tmp_path, **change).open("train", WindowSettings())


def test_a_broken_state_file_is_refused(tmp_path):
    (tmp_path / "toy").mkdir()
    (tmp_path / "toy" / "cache.json").write_text("{")
    with pytest.raises(ValueError, match="state in JSON"):
        ConvertedCache("toy", str(tmp_path)).identity()


def test_an_unknown_split_lists_the_known_ones(source, windows):
    with pytest.raises(ValueError, match="one of test, train, val, but got 'dev'"):
        source.open("dev", windows)


def test_a_step_that_the_cache_cannot_give_is_refused(source):
    with pytest.raises(ValueError, match="`dt_s` must be a multiple.*Convert the data"):
        source.open("train", WindowSettings(dt_s=0.25, history_s=4.0, horizon_s=3.0))


def test_the_identity_changes_with_the_conversion(cache, source, tmp_path):
    changed = broken(cache, tmp_path, settings_hash="other")
    assert changed.identity() != source.identity()


def test_a_named_data_set_needs_its_recordings(tmp_path):
    with pytest.raises(ValueError, match="`root` must be a folder"):
        NamedDataset("sdd", str(tmp_path / "none"), str(tmp_path)).open("train", WindowSettings())


def test_a_name_that_trajdata_does_not_know_is_refused(tmp_path):
    with pytest.raises(ValueError, match="`name` must be known to trajdata, but got 'kitti'"):
        NamedDataset("kitti", str(tmp_path), str(tmp_path)).open("train", WindowSettings())


def test_an_unknown_split_of_a_named_data_set_lists_its_tags(tmp_path):
    with pytest.raises(ValueError, match="`split` must be part of a tag of 'sdd'.*'dev'"):
        NamedDataset("sdd", str(tmp_path), str(tmp_path)).open("dev", WindowSettings())


@pytest.mark.parametrize(
    ("name", "expected"), [("sdd", ["UpwardY", "HeldHeading"]), ("eupeds_eth", ["HeldHeading"])]
)
def test_picture_coordinates_are_turned_up(name, expected, tmp_path):
    repairs = NamedDataset(name, str(tmp_path), str(tmp_path)).corrections
    assert [type(repair).__name__ for repair in repairs] == expected
