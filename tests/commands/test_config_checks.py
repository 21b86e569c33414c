"""Checks of a configuration before anything is built."""

import json
import math
import re

import pytest

from diffstack_mmv.commands.config_checks import (
    require_checkpoint,
    require_complete,
    require_file,
    require_folder,
    require_same_type,
    require_seed,
    require_share,
)
from diffstack_mmv.commands.data_checks import (
    require_data,
    require_own_vehicle,
    require_recordings,
    require_same_horizon,
    require_situations,
    require_split,
    require_step_of,
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
        ({"b": {"c": 1}}, {"b": {"c": "x"}}, "a number"),
        ({"b": {"c": 1}}, {"b": 2}, "settings, each with its name"),
        ({"b": 1}, [2], "settings, each with its name"),
    ],
)
def test_a_value_of_another_type_is_refused(default, value, wanted):
    with pytest.raises(ValueError, match=f"`a.*` must be {wanted}, but got .* Write [+][+]a"):
        require_same_type("a", default, value)


@pytest.mark.parametrize("value", ["b", 1])
def test_one_value_instead_of_a_list_is_told_how_a_list_is_written(value):
    told = f"`a` must be a list, but got {value!r}. Write a=[{value}]."
    with pytest.raises(ValueError, match=re.escape(told)):
        require_same_type("a", ["a"], value)


@pytest.mark.parametrize(
    ("default", "value"),
    [
        (None, "x"),
        (1, None),
        (1, 2.0),
        (1.0, 1),
        ([0.8, 0.9], 0.8),
        ({"b": 1}, "name of a file"),
        ("auto", 2),
    ],
)
def test_values_that_mean_something_pass(default, value):
    require_same_type("a", default, value)


def test_a_list_in_place_of_a_number_is_for_parts_alone():
    require_same_type("vehicle.friction.initial", 0.8, [0.8, 0.9], in_part=True)
    require_same_type("vehicle", {"friction": 0.8}, {"friction": [0.8, 0.9]}, in_part=True)
    require_same_type("trainer", {"_target_": "T", "devices": 1}, {"devices": [0, 1]})


@pytest.mark.parametrize("key", ["seed", "limits.speed_max_mps"])
def test_a_list_in_place_of_a_number_of_the_command_is_refused(key):
    told = f"`{key}` must be a number, but got [0, 1]. Give one; -m {key}=A,B runs the command for"
    with pytest.raises(ValueError, match=re.escape(told)):
        require_same_type(key, 0, [0, 1])


def test_every_value_that_must_be_given_is_named():
    with pytest.raises(ValueError, match="`a.b` must be given. Add a.b=VALUE c=VALUE"):
        require_complete({"a": {"b": "???"}, "c": "???", "d": "${a.b}"})


@pytest.mark.parametrize(
    ("mode", "horizon_s", "told"),
    [
        ("bike", 3.0, "`modes` must be one of"),
        ("bicycle", 2.95, "`horizon_s` must be a multiple"),
    ],
)
def test_windows_of_unknown_modes_or_broken_steps_are_refused(mode, horizon_s, told):
    require_windows(["bicycle"], 0.1, horizon_s=3.0)
    with pytest.raises(ValueError, match=told):
        require_windows([mode], 0.1, horizon_s=horizon_s)


@pytest.mark.usefixtures("unchecked")
def test_one_mode_in_place_of_a_list_is_told_with_the_list():
    with pytest.raises(ValueError, match=r"be a list, but got 'bicycle'. Write modes=\[bicycle\]"):
        require_windows("bicycle", 0.1)


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


@pytest.mark.parametrize("seed", [None, 0, 7, 2**32 - 1])
def test_a_seed_that_every_generator_takes_passes(seed):
    require_seed(seed)


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_a_seed_out_of_range_is_shown(seed):
    with pytest.raises(ValueError, match=f"`seed` must lie in .*, but got {seed}"):
        require_seed(seed)


@pytest.mark.parametrize("share", [1e-3, 0.5, 1.0, 1, 2, 20.0])
def test_a_share_or_a_number_of_batches_passes(share):
    require_share("a", share)


@pytest.mark.parametrize("share", [0.0, -0.5, 1.5, -3, math.nan, math.inf])
def test_what_is_neither_a_share_nor_a_number_is_shown(share):
    with pytest.raises(ValueError, match=f"`a` must lie in .*, but got {share}"):
        require_share("a", share)


@pytest.mark.parametrize("name", [None, "none", "file"])
def test_what_is_no_folder_is_refused_with_its_remedy(tmp_path, name):
    (tmp_path / "file").touch()
    require_folder("root", str(tmp_path), "")
    place = name and str(tmp_path / name)
    with pytest.raises(ValueError, match="`root` must be an existing folder.*Give root=FOLDER"):
        require_folder("root", place, "Give root=FOLDER.")


@pytest.mark.parametrize(("name", "needs"), [(None, "be given"), (".", "be an existing file")])
def test_what_is_no_file_is_refused_with_its_remedy(tmp_path, name, needs):
    place = name and str(tmp_path / name)
    with pytest.raises(ValueError, match=f"`controls` must {needs}, but got .*Write one"):
        require_file("controls", place, "Write one.")


@pytest.mark.parametrize(("name", "needs"), [(None, "be given"), ("a.ckpt", "be readable")])
def test_a_checkpoint_is_an_archive(tmp_path, name, needs):
    (tmp_path / "a.ckpt").write_text("text")
    with pytest.raises(ValueError, match=f"`start` must {needs}"):
        require_checkpoint("start", name and str(tmp_path / name))


def test_the_folder_of_a_run_is_told_with_its_checkpoint(tmp_path):
    best = tmp_path / "checkpoints" / "best.ckpt"
    best.parent.mkdir()
    best.touch()
    with pytest.raises(ValueError, match=f"existing file, but got .* Did you mean {best}\\?"):
        require_checkpoint("checkpoint", str(tmp_path))


@pytest.fixture
def source(tmp_path):
    """A finished conversion of a scene in which somebody rides a bicycle."""
    scenes = [{"split": "train", "agents": {"bicycle": 1}}]
    state = {"format_version": 1, "complete": True, "dt_s": 0.1, "scenes": scenes}
    (tmp_path / "toy").mkdir()
    (tmp_path / "toy" / "cache.json").write_text(json.dumps(state))
    return {"folder": str(tmp_path), "name": "toy"}


@pytest.mark.parametrize(
    ("place", "told"),
    [
        ({"root": "none"}, "`root` must be an existing folder"),
        ({"folder": "none", "name": "toy"}, "hold a finished conversion"),
    ],
)
def test_a_source_needs_its_folder(tmp_path, monkeypatch, place, told):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=told):
        require_recordings(place)


def test_a_source_needs_tracks_of_the_mode(source):
    require_tracks(source, ["train", "val"], "bicycle")
    with pytest.raises(ValueError, match="`mode` must have tracks"):
        require_tracks(source, ["train"], "scooter")


@pytest.mark.parametrize(
    ("splits", "told"),
    [
        (["train", "vla"], "`splits` must be one of train, but got 'vla'[.]$"),
        (["train", "trainn"], "but got 'trainn'. Did you mean 'train'[?]$"),
        (["val"], "`splits` must be one of train, but got 'val'"),
        ([], r"`splits` must name some of train, but got \[\]"),
    ],
)
def test_splits_without_scenes_are_named_beside_those_that_are_there(source, splits, told):
    with pytest.raises(ValueError, match=told):
        require_tracks(source, splits, "bicycle")


def test_tracks_that_are_read_row_by_row_keep_their_step(source):
    require_step_of(source, 0.1)
    require_step_of({"root": "recordings"}, 0.2)
    with pytest.raises(
        ValueError, match="`dt_s` must be 0.1 as in .* got 0.2 for 'toy'. Give dt_s"
    ):
        require_step_of(source, 0.2)


@pytest.mark.parametrize("split", ["train", "all"])
def test_a_split_with_scenes_or_all_of_them_passes(source, split):
    require_split("split", split, source)


def test_a_split_without_scenes_is_refused_unless_the_source_has_its_own(source):
    with pytest.raises(ValueError, match="`split` must be one of train, but got 'val'"):
        require_split("split", "val", source)
    require_split("split", "val", {"root": "recordings"})


def test_situations_are_those_that_windows_are_told_to_belong_to():
    require_situations(["moving", "turning"])
    with pytest.raises(ValueError, match="`situations` must be one of .*moving.*'flying'"):
        require_situations(["moving", "flying"])


@pytest.mark.parametrize(("wanted", "found"), [("dt_s", 0.2), ("horizon_s", 2.0)])
def test_a_checkpoint_is_judged_with_the_times_of_its_training(wanted, found):
    trained = {"dt_s": 0.1, "horizon_s": 3.0}
    require_same_horizon(trained, trained)
    with pytest.raises(ValueError, match=f"`{wanted}` must be .* as in the training, but got"):
        require_same_horizon(trained | {wanted: found}, trained)


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
