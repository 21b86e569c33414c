"""Environments and their splits as trajdata sees them."""

from pathlib import Path

import pytest

from dmmv_conventions.opening import CachedEnvironment, environment

SCENES = [
    {"name": "a", "split": "train", "steps": 10},
    {"name": "b", "split": "test", "steps": 20},
    {"name": "c", "split": "train", "steps": 30},
]
STATE = {"dataset": "toy", "dt_s": 0.1, "location": "here", "scenes": SCENES}


@pytest.mark.parametrize(
    ("split", "expected"),
    [("train", [("a", 10, 0), ("c", 30, 2)]), ("test", [("b", 20, 1)]), ("val", [])],
)
def test_the_scenes_of_a_split_come_from_the_state(split, expected):
    opened = CachedEnvironment(Path("cache"), STATE)
    (tag,) = opened.get_matching_scene_tags({"toy", split})
    scenes = opened._get_matching_scenes_from_cache(tag, None, env_cache=None)
    assert [(s.name, s.length_timesteps, s.raw_data_idx) for s in scenes] == expected
    assert all(scene.location == "here" for scene in scenes)


def test_an_environment_holds_no_absolute_path():
    assert environment("toy", 0.1, {}).data_dir == Path("toy")
