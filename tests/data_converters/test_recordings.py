"""Scenes have names that can be those of folders, and tell the recording that they are part of."""

import json
import re

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_converters import convert
from data_converters.recordings import LONGEST_NAME, scene_names
from diffstack_mmv.data import ConvertedCache, WindowSettings
from diffstack_mmv.data.dataset import DirectWindows
from dmmv_conventions.cache import read_state

KEYS = st.text(st.sampled_from("ab/-_. \x00ü") | st.characters(), min_size=1, max_size=200)


@given(st.lists(KEYS, unique=True))
def test_names_of_scenes_are_unique_and_plain(keys):
    names = scene_names(keys)
    assert list(names) == keys
    assert len(set(names.values())) == len(keys)
    for name in names.values():
        assert re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.]*", name)
        assert len(name) <= LONGEST_NAME


@pytest.mark.parametrize(
    ("key", "name"),
    [("cyclists/moving/17", "cyclists_moving_17"), ("2023-05-04", "2023_05_04"), ("a.1", "a.1")],
)
def test_a_plain_key_stays_readable(key, name):
    assert scene_names([key]) == {key: name}


def test_a_name_depends_on_nothing_but_its_key_unless_it_is_taken():
    alone, among = scene_names(["ü"])["ü"], scene_names(["a", "ü", "b"])["ü"]
    assert alone == among
    assert scene_names(["a/b", "a-b"])["a/b"] == "a_b"


def times_of_scenes(folder):
    return {path.parent.name: path.stat().st_mtime_ns for path in folder.glob("*/conversion.json")}


def test_files_of_one_recording_name_it_in_the_cache_and_in_the_samples(thab, thab_settings):
    moving = thab / "cyclists" / "moving"
    track = pd.read_csv(moving / "21.csv", index_col=0)
    track.assign(x=track["x"] + 50).to_csv(moving / "20_2.csv")
    settings = thab_settings()
    convert(settings)
    scenes = read_state(settings.cache, "thab_vru")["scenes"]
    parts = [each for each in scenes if each["recording"] == "cyclists/20"]
    assert [each["name"] for each in parts] == ["cyclists_moving_20", "cyclists_moving_20_2"]
    source = ConvertedCache("thab_vru", str(settings.cache))
    opened = source.open(parts[0]["split"], WindowSettings(ego_modes=("bicycle",)))
    samples = DirectWindows(opened, "thab_vru").samples
    of_one = samples[samples["recording"] == "cyclists/20"]
    assert set(of_one["scene"]) == {each["name"] for each in parts}


def test_a_cache_of_before_learns_its_recordings_without_a_new_conversion(thab_settings):
    settings = thab_settings()
    convert(settings)
    place = settings.cache / "thab_vru" / "cache.json"
    told = place.read_text()
    state = json.loads(told)
    state["scenes"] = [{k: v for k, v in s.items() if k != "recording"} for s in state["scenes"]]
    place.write_text(json.dumps(state))
    written = times_of_scenes(place.parent)
    convert(settings)
    assert times_of_scenes(place.parent) == written
    assert place.read_text() == told
