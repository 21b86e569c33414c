"""Environments and their splits as trajdata sees them."""

import os
from pathlib import Path

import pytest
from trajdata.caching.env_cache import EnvCache

from dmmv_conventions.cache import TRUSTED_VARIABLE
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
    scenes = opened._get_matching_scenes_from_cache(tag, None, EnvCache(Path("cache")))
    assert [(s.name, s.length_timesteps, s.raw_data_idx) for s in scenes] == expected
    assert all(scene.location == "here" for scene in scenes)


def test_an_environment_holds_no_absolute_path():
    assert environment("toy", 0.1, {}).data_dir == Path("toy")


@pytest.fixture
def foreign(tmp_path, monkeypatch):
    """A cache that another user has written: this process is someone else."""
    (tmp_path / "toy" / "scene").mkdir(parents=True)
    (tmp_path / "toy" / "scene" / "scene_metadata_dt0.10.dill").write_bytes(b"")
    user = tmp_path.stat().st_uid + 1
    monkeypatch.setattr("os.geteuid", lambda: user)
    monkeypatch.setattr("dmmv_conventions.cache.ADMINISTRATOR", user)
    return tmp_path


def test_pickles_of_another_user_are_refused_with_a_way_to_make_them_anew(foreign):
    with pytest.raises(ValueError, match="`cache` must be written by you") as told:
        CachedEnvironment(foreign, STATE)
    assert f"data=csv data.name=toy data.root=RECORDINGS data.cache={foreign}" in str(told.value)


def test_the_cache_of_a_trusted_user_is_read(foreign, monkeypatch):
    monkeypatch.setenv(TRUSTED_VARIABLE, f"/elsewhere:{foreign}")
    assert CachedEnvironment(foreign, STATE).name == "toy"


@pytest.mark.parametrize("name", ["theirs", "theirs/scene", "nowhere"])
def test_links_are_followed_to_the_files_of_another_user(tmp_path, monkeypatch, name):
    (tmp_path / "theirs" / "scene").mkdir(parents=True)
    (tmp_path / "toy").mkdir()
    (tmp_path / "toy" / "a").symlink_to(tmp_path / name)
    (tmp_path / "toy" / "again").symlink_to(tmp_path / "toy")  # a loop
    plain = Path.stat

    def stat(path, **options):
        found = plain(path, **options)
        changed = (found.st_mode, 0, 0, 0, found.st_uid + 1, *(0,) * 5)
        return os.stat_result(changed) if "theirs" in path.parts else found

    monkeypatch.setattr(Path, "stat", stat)
    monkeypatch.setattr("dmmv_conventions.cache.ADMINISTRATOR", os.geteuid())
    if name == "nowhere":
        assert CachedEnvironment(tmp_path, STATE).name == "toy"
    else:
        with pytest.raises(ValueError, match=name):
            CachedEnvironment(tmp_path, STATE)
