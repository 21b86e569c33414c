"""What can be wrong with a source, and what is said about it."""

import json

import pytest

from diffstack_mmv.data import ConvertedCache, NamedDataset, WindowSettings
from diffstack_mmv.data.sources import _require_resampling


def broken(cache, tmp_path, **changes):
    state = json.loads((cache / "toy" / "cache.json").read_text()) | changes
    (tmp_path / "toy").mkdir()
    (tmp_path / "toy" / "cache.json").write_text(json.dumps(state))
    return ConvertedCache("toy", str(tmp_path))


ASKED = {
    "identity": lambda source: source.identity(),
    "smoother": lambda source: source.smoother(),
    "scenes": lambda source: source.scenes(),
    "windows": lambda source: source.open("train", WindowSettings()),
}


@pytest.mark.parametrize("ask", ASKED.values(), ids=ASKED)
def test_an_unfinished_cache_is_refused_whatever_is_asked(cache, tmp_path, ask):
    with pytest.raises(ValueError, match="`complete` must be true"):
        ask(broken(cache, tmp_path, complete=False))


@pytest.mark.parametrize(
    ("split", "windows", "complaint"),
    [
        ("dev", {}, "one of test, train, val, but got 'dev' for 'toy'"),
        ("train", {"dt_s": 0.25}, "`dt_s` must be a multiple.*Convert the data"),
        ("train", {"dt_s": 0.08}, "`dt_s` must be a multiple.*0.08"),
        # a row between two would be made of the next one
        ("train", {"dt_s": 0.05}, "`dt_s` must be a multiple of 0.1, but got 0.05"),
    ],
)
def test_a_split_or_step_that_the_cache_lacks_is_refused(source, split, windows, complaint):
    with pytest.raises(ValueError, match=complaint):
        source.open(split, WindowSettings(**{"history_s": 4.0, "horizon_s": 2.0, **windows}))


@pytest.mark.parametrize("change", [{"settings_hash": "other"}, {"location": "there"}])
def test_the_identity_changes_with_the_conversion(cache, source, tmp_path, change):
    assert broken(cache, tmp_path, **change).identity() != source.identity()


@pytest.mark.parametrize(
    ("name", "root", "split", "complaint"),
    [
        ("sdd", "none", "train", "`root` must be a folder"),
        ("kitti", "", "train", "`name` must be known to trajdata, but got 'kitti'"),
        ("sdd", "", "dev", "`split` must be part of a tag of 'sdd'.*'dev'"),
    ],
)
def test_a_named_data_set_that_cannot_be_opened_is_told(tmp_path, name, root, split, complaint):
    with pytest.raises(ValueError, match=complaint):
        NamedDataset(name, str(tmp_path / root), str(tmp_path)).open(split, WindowSettings())


@pytest.mark.parametrize(
    ("name", "expected"), [("sdd", ["UpwardY", "HeldHeading"]), ("eupeds_eth", ["HeldHeading"])]
)
def test_picture_coordinates_are_turned_up(name, expected, tmp_path):
    repairs = NamedDataset(name, str(tmp_path), str(tmp_path)).corrections
    assert [type(repair).__name__ for repair in repairs] == expected


def test_scenes_are_chosen_by_name_or_pattern(cache, source):
    names = [scene["name"] for scene in source.scenes()]
    chosen = ConvertedCache("toy", str(cache), sequences=[names[0]])
    assert [scene["name"] for scene in chosen.scenes()] == names[:1]
    assert chosen.identity() != source.identity()
    every = ConvertedCache("toy", str(cache), sequences=["*"])
    assert every.scenes() == source.scenes()
    split = source.scenes()[0]["split"]
    windows = WindowSettings(history_s=1.0, horizon_s=1.0, ego_modes=("bicycle", "scooter"))
    assert set(chosen.open(split, windows).locations().scene) <= {names[0]}


@pytest.mark.parametrize("ask", ["scenes", "open"])
def test_a_scene_that_is_not_there_is_told(cache, ask):
    source = ConvertedCache("toy", str(cache), sequences=["nowhere_*"])
    with pytest.raises(ValueError, match="`sequences` must name scenes such as .*nowhere"):
        source.scenes() if ask == "scenes" else source.open("train", WindowSettings())


def test_scenes_of_data_that_trajdata_reads_cannot_be_chosen(tmp_path):
    with pytest.raises(ValueError, match="`sequences` must be null"):
        NamedDataset("sdd", str(tmp_path), str(tmp_path), sequences=["a"])


@pytest.mark.parametrize(
    ("recorded_s", "dt_s", "told"), [(0.4, 0.1, True), (0.1, 0.3, False), (0.4, 0.4, False)]
)
def test_a_data_set_of_larger_steps_is_interpolated_and_that_is_told(
    recorded_s, dt_s, told, caplog
):
    _require_resampling(WindowSettings(dt_s=dt_s, history_s=1.2, horizon_s=1.2), recorded_s, "here")
    assert ("look ahead by up to 0.4 s" in caplog.text) == told


def test_a_step_between_those_of_a_data_set_is_refused():
    with pytest.raises(ValueError, match="`dt_s` must be a multiple of 0.4, but got 0.3"):
        _require_resampling(WindowSettings(dt_s=0.3, history_s=1.2, horizon_s=1.2), 0.4, "here")
