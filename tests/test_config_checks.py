"""Checks of a configuration before anything is built."""

import json

import pytest

from diffstack_mmv.config_checks import (
    require_checkpoint,
    require_complete,
    require_data,
    require_own_vehicle,
    require_recordings,
    require_same_type,
    require_tracks,
    require_windows,
)


@pytest.mark.parametrize(
    ("default", "value", "wanted"),
    [
        (1, "many", "a number"),
        (0.1, True, "a number"),
        (1, 1.5, "a whole number"),
        (True, "maybe", "true or false"),
        (["a"], "a", "a list"),
        (["a"], 1, "a list"),
        ({"b": {"c": 1}}, {"b": {"c": "x"}}, "a number"),
        ({"b": {"c": 1}}, {"b": 2}, "settings, each with its name"),
        ({"b": 1}, [2], "settings, each with its name"),
    ],
)
def test_a_value_of_another_type_is_refused(default, value, wanted):
    with pytest.raises(ValueError, match=f"`a.*` must be {wanted}, but got .* Write [+][+]a"):
        require_same_type("a", default, value)


@pytest.mark.parametrize(
    ("default", "value"),
    [
        (None, "x"),
        (1, None),
        (1, 2.0),
        (1.0, 1),
        (0.8, [0.8, 0.9]),
        ([0.8, 0.9], 0.8),
        ({"b": 1}, "name of a file"),
        ("auto", 2),
    ],
)
def test_values_that_mean_something_pass(default, value):
    require_same_type("a", default, value)


def test_every_value_that_must_be_given_is_named():
    with pytest.raises(ValueError, match="`a.b` must be given. Add a.b=VALUE c=VALUE"):
        require_complete({"a": {"b": "???"}, "c": "???", "d": "${a.b}"})


@pytest.mark.parametrize(
    ("mode", "horizon_s", "told"),
    [
        ("bike", 3.0, "`mode` must be one of"),
        ("bicycle", 2.95, "`horizon_s` must be a multiple"),
    ],
)
def test_windows_of_unknown_modes_or_broken_steps_are_refused(mode, horizon_s, told):
    require_windows(["bicycle"], 0.1, horizon_s=3.0)
    with pytest.raises(ValueError, match=told):
        require_windows([mode], 0.1, horizon_s=horizon_s)


@pytest.mark.parametrize(
    ("changed", "batch_size", "told"),
    [
        ({"neighbors": -1}, 64, "`data.neighbors` must be at least 0, but got -1"),
        ({"radius_m": 0.0}, 64, "`data.radius_m` must be positive, but got 0"),
        ({"stride": 0}, 64, "`data.stride` must be at least 1, but got 0"),
        ({}, 0, "`batch_size` must be at least 1, but got 0"),
    ],
)
def test_numbers_of_windows_and_batches_are_refused_by_their_keys(changed, batch_size, told):
    windows = {"neighbors": 0, "radius_m": 30.0, "stride": 1}
    require_data(windows, 1)
    with pytest.raises(ValueError, match=told):
        require_data(windows | changed, batch_size)


def test_a_checkpoint_is_an_archive(tmp_path):
    with pytest.raises(ValueError, match="`start` must be given"):
        require_checkpoint("start", None)
    (tmp_path / "a.ckpt").write_text("text")
    with pytest.raises(ValueError, match="`start` must be readable"):
        require_checkpoint("start", str(tmp_path / "a.ckpt"))


def test_a_source_needs_its_folder_and_tracks_of_the_mode(tmp_path):
    with pytest.raises(ValueError, match="`root` must be an existing folder"):
        require_recordings({"root": str(tmp_path / "none")})
    source = {"folder": str(tmp_path), "name": "toy"}
    with pytest.raises(ValueError, match="hold a finished conversion"):
        require_recordings(source)
    scenes = [{"split": "train", "agents": {"bicycle": 1}}]
    state = {"format_version": 1, "complete": True, "scenes": scenes}
    (tmp_path / "toy").mkdir()
    (tmp_path / "toy" / "cache.json").write_text(json.dumps(state))
    require_tracks(source, ["train"], "bicycle")
    for splits, mode in ((["train"], "scooter"), (["val"], "bicycle")):
        with pytest.raises(ValueError, match="`mode` must have tracks"):
            require_tracks(source, splits, mode)


BICYCLE = {"name": "tadpole", "mode": "bicycle"}


@pytest.mark.parametrize(
    ("modes", "shared"),
    [(["bicycle"], False), (["pedestrian", "bicycle"], False), (["bicycle", "scooter"], True)],
)
def test_a_vehicle_drives_its_mode_or_all_if_it_is_meant_so(modes, shared):
    require_own_vehicle(modes, BICYCLE, shared=shared)


def test_agents_that_another_vehicle_drives_are_refused():
    with pytest.raises(ValueError, match=r"`modes`.*'tadpole' \(bicycle\).*\[bicycle, scooter\]"):
        require_own_vehicle(["bicycle", "scooter"], BICYCLE, shared=False)
