"""IMPTC sequences and the VRU release: splits, context, and the join of both."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest
from trajdata.maps.traffic_light_status import TrafficLightStatus

from data_converters import (
    ConversionError,
    ConversionSettings,
    ImptcDataset,
    ImptcVruDataset,
    SequenceSplit,
    convert,
)
from data_converters.imptc import vru
from data_converters.imptc.context import read_context, read_table, signals_per_step
from data_converters.imptc.dataset import find_sequences, sequences_at
from data_converters.imptc.vru_recordings import connected, overlapping, recording_splits
from data_converters.imptc.vru_release import VruTrack
from tests.data_converters.synthetic import first_scene


@pytest.mark.parametrize(
    ("number", "split"),
    [
        (0, "train"),
        (49, "train"),
        (50, "val"),
        (99, "val"),
        (100, "train"),
        (150, "val"),
        (199, "val"),
        (200, "test"),
        (269, "test"),
        (270, None),
    ],
)
def test_sets_are_split_as_published(number, split):
    assert SequenceSplit().of(number) == split


def test_the_split_can_be_changed_by_set_and_by_number():
    split = SequenceSplit(train=("set_05",), val=(), test=("set_01",), exceptions={3: "val"})
    assert [split.of(number) for number in (200, 0, 3, 60)] == ["train", "test", "val", None]


@pytest.mark.parametrize(
    "options",
    [
        {"train": ("set_09",)},
        {"train": ("set_01",), "test": ("set_01",)},
        {"exceptions": {1: "eval"}},
    ],
)
def test_an_impossible_split_is_refused(options):
    with pytest.raises(ConversionError, match="split|exceptions"):
        SequenceSplit(**options)


@pytest.mark.parametrize("depth", ["", "imptc_set_01", "a/b"])
def test_sequences_are_found_at_any_depth(tmp_path, depth):
    (tmp_path / depth / "0007_20230322_081506").mkdir(parents=True)
    assert list(find_sequences(tmp_path)) == ["0007_20230322_081506"]


def test_a_sample_sequence_that_repeats_one_of_the_sets_is_read_once(tmp_path):
    (tmp_path / "imptc_samples" / "0001_20230523_105516").mkdir(parents=True)
    (tmp_path / "imptc_set_03" / "0123_20230523_105516").mkdir(parents=True)
    assert list(find_sequences(tmp_path)) == ["0123_20230523_105516"]


def test_sequences_that_are_left_out_stand_in_the_report(tmp_path):
    repeated, taken, unused = (
        "samples/0001_20230523_105516", "set_03/0123_20230523_105516", "0270_20230524_100000",
    )  # fmt: skip
    for place in (repeated, taken, unused):
        (tmp_path / place).mkdir(parents=True)
    assert ImptcDataset(tmp_path).notes() == {
        "repeated_sequences": [repeated],
        "unused_sequences": [unused],
    }


def test_read_tracks_lists_all_samples_of_a_sequence(sample):
    folder = next(sample.glob("0000_*"))
    table = ImptcDataset(sample).read_tracks(folder)
    assert len(table["agent_id"].unique()) == len(list(folder.glob("v*/*")))
    assert table.groupby("agent_id")["timestamp_us"].is_monotonic_increasing.all()


@pytest.mark.parametrize("torn", [0, 1])
def test_a_vehicle_of_which_a_cuboid_is_missing_is_counted(sample, tmp_path, torn):
    folder = next(sample.glob("0000_*"))
    shutil.copytree(folder, tmp_path / folder.name)
    for path in sorted((tmp_path / folder.name / "vehicles").glob("*/track.json"))[:torn]:
        content = json.loads(path.read_text())
        del next(iter(content["track_data"].values()))["cuboid"]
        path.write_text(json.dumps(content))
    raw = first_scene(ImptcDataset(tmp_path))
    assert raw.notes["vehicles_without_cuboids"] == torn
    vehicles = [track for track in raw.tracks if track.name.startswith("vehicle")]
    assert sum(track.extent is None for track in vehicles) == torn < len(vehicles)


def test_a_file_beside_the_folders_of_tracks_is_none(sample, tmp_path):
    folder = next(sample.glob("0000_*"))
    shutil.copytree(folder, tmp_path / folder.name)
    (tmp_path / folder.name / "vrus" / "README.txt").write_text("tracks")
    raw = first_scene(ImptcDataset(tmp_path), strict=False)
    assert (len(raw.tracks), raw.rejected) == (len(list(folder.glob("v*/*"))), [])


def test_lights_and_weather_stand_beside_the_scene(converted):
    folder = next(converted.glob("imptc/0000_*"))
    lights = pd.read_parquet(folder / "traffic_lights.parquet")
    assert set(lights["k1"]) <= {2, 4, 10, 11, 20, 30}
    assert np.diff(lights["time_s"]).mean() == pytest.approx(1.0, abs=0.01)
    assert "air_temperature" in pd.read_parquet(folder / "weather.parquet")
    signals = pd.read_feather(folder / "tls_data_dt0.10.feather")
    assert set(signals["status"]) <= {status.value for status in TrafficLightStatus}


@pytest.mark.parametrize("last", [7, 29, 46, 57])
def test_lights_have_as_many_steps_as_the_agents(tmp_path, last) -> None:
    start, folder = 1_672_574_400_000_000, tmp_path / "raw" / "0000_20230101_120000"
    samples = {
        str(n): {"ts": str(start + 100_000 * n), "coordinates": [0.3 * n, 0.0, 0.0], "status": 2}
        for n in range(last + 1)
    }
    track = {"overview": {"class_id": 2}, "track_data": samples}
    lights = {"status_data": {f"ts_{start}": {"k1": 4, "f1": 10}}}
    for file, content in {"vrus/0/track": track, "context/traffic_light_signals": lights}.items():
        (folder / file).parent.mkdir(parents=True)
        (folder / f"{file}.json").write_text(json.dumps(content))
    dataset = ImptcDataset(tmp_path / "raw")
    raw = dataset.read(dataset.scenes()[0], 0.1, strict=True)
    assert raw.signals.index.get_level_values("scene_ts").max() == last


def test_a_step_takes_the_latest_state_and_none_before_the_first():
    lights = pd.DataFrame({"time_s": [0.25, 0.55], "k1": [10, 4], "f1": [4, 10]})
    status = signals_per_step(lights, 8, 0.1)["status"]
    red, green, none = TrafficLightStatus.RED, TrafficLightStatus.GREEN, TrafficLightStatus.NO_DATA
    assert status["k1"].tolist() == [none] * 3 + [red] * 3 + [green] * 2
    assert status["f1"].tolist() == [none] * 3 + [green] * 3 + [red] * 2


@pytest.mark.parametrize("key", ["1679472906000000", "ts_1679472906000000"])
def test_a_context_entry_without_inner_time_is_dated_by_its_key(tmp_path, key):
    path = tmp_path / "lights.json"
    path.write_text(json.dumps({"status_data": {key: {"k1": 4}}}))
    table = read_table(path, "status_data", 1_679_472_905_000_000)
    assert table["time_s"].tolist() == [1.0]


@pytest.mark.parametrize(
    "text",
    ["{", '{"status_data": {"ts_0": {"k1": 4}}}', '{"status_data": {"1679472906000000": 4}}'],
)
def test_broken_context_is_counted_and_left_out(tmp_path, text):
    (tmp_path / "traffic_light_signals.json").write_text(text)
    assert read_context(tmp_path, 0) == ({}, 1)


def test_tracks_of_the_vru_release_that_overlap_in_time_are_one_scene(vru_sample, tmp_path):
    dataset = ImptcVruDataset(vru_sample)
    report = convert(ConversionSettings(dataset, tmp_path, progress=False))
    tracks = len(list(vru_sample.glob("*/*/track.json")))
    # the sample has three sequences, minutes apart
    assert report.totals()["tracks_read"] == tracks
    assert report.totals()["scenes"] == 3
    for scene in dataset._scenes.values():
        assert len({track.sequence for track in scene.tracks}) == 1
        assert scene.tracks[0].first_us <= max(track.last_us for track in scene.tracks)


def test_recordings_of_the_vru_release_with_mixed_splits_are_dealt_as_a_whole(vru_sample):
    splits = [scene.split for scene in ImptcVruDataset(vru_sample).scenes()]
    assert sorted(splits) == ["test", "train", "val"]


@pytest.mark.parametrize(("pause_us", "recordings"), [(vru.PAUSE_US, 3), (10**14, 1)])
def test_scenes_with_short_pauses_between_them_are_of_one_recording(
    vru_sample, monkeypatch, pause_us, recordings
):
    monkeypatch.setattr(vru, "PAUSE_US", pause_us)
    scenes = ImptcVruDataset(vru_sample).scenes()
    told = [scene.recording for scene in scenes]
    assert (len(told), len({*told}), told[0]) == (3, recordings, scenes[0].name)


@pytest.mark.parametrize(("folder", "split"), [("eval", "val"), ("test", "test")])
def test_a_recording_with_one_published_split_keeps_it(folder, split):
    tracks = [VruTrack(f"{folder}/{n}", "", "a", 0, 1) for n in range(3)]
    assert recording_splits([0, 0, 0], tracks, {}) == {0: split}


@pytest.mark.parametrize(
    "folders", [("train", "test"), ("test", "eval"), ("eval", "test", "train")]
)
@pytest.mark.parametrize("known", ["train", "val", "test"])
def test_a_recording_of_several_splits_takes_that_of_its_sequence(folders, known) -> None:
    tracks = [VruTrack(f"{folder}/0", "", "a", 0, 1) for folder in folders]
    assert recording_splits([0] * len(folders), tracks, {"a": known}) == {0: known}


SECOND = 1_000_000


@pytest.mark.parametrize(
    ("spans", "groups"),
    [
        ([(0, 10), (5, 12), (11, 20)], [0, 0, 0]),
        ([(0, 10), (11, 20), (60, 70)], [0, 0, 2]),
        ([(0, 10), (0, 4000), (5, 12)], [0, 1, 0]),
        ([(0, 10), (0, -1), (5, 12)], [0, 1, 0]),
        ([(5, 12), (0, 3600), (3630, 3631), (3662, 3663)], [1, 1, 1, 3]),
    ],
    ids=["a chain", "a short and a long pause", "a broken clock", "no clock", "just the longest"],
)
def test_tracks_are_grouped_by_their_times(spans, groups):
    tracks = [VruTrack(str(n), "", "", a * SECOND, b * SECOND) for n, (a, b) in enumerate(spans)]
    assert overlapping(tracks, pause_us=30 * SECOND) == groups


def test_groups_of_one_sequence_are_one_recording():
    labels = connected([0, 1, 2, 2], ["a", "", "a", ""])
    assert labels[0] == labels[2] == labels[3] != labels[1]


def test_the_combined_files_give_the_same_tracks_as_the_folders(vru_sample, tmp_path):
    combined = tmp_path / "combined"
    combined.mkdir()
    for path in vru_sample.glob("*_tracks.json"):
        shutil.copy(path, combined)
    reports = [
        convert(ConversionSettings(ImptcVruDataset(root), tmp_path / root.name, progress=False))
        for root in (vru_sample, combined)
    ]
    assert reports[0].totals() == reports[1].totals()


@pytest.mark.parametrize("packed", ["train", "eval"])
def test_a_combined_file_counts_although_a_folder_without_tracks_lies_beside_it(
    vru_sample, tmp_path, packed
):
    root = tmp_path / "partly"
    shutil.copytree(vru_sample, root)
    before = ImptcVruDataset(root).scenes()
    shutil.rmtree(root / packed)
    (root / packed).mkdir()
    after = ImptcVruDataset(root)
    tracks = [len(scene.tracks) for scene in after._scenes.values()]
    assert [scene.name for scene in after.scenes()] == [scene.name for scene in before]
    assert sum(tracks) == len(list(vru_sample.glob("*/*/track.json")))


@pytest.mark.parametrize("release", ["typo", ""])
def test_another_release_that_is_not_there_is_told(vru_sample, tmp_path, release):
    with pytest.raises(ConversionError, match="`root` must hold sequence folders"):
        ImptcVruDataset(vru_sample, sequences=sequences_at(str(tmp_path / release))).scenes()


def test_tracks_of_unknown_sequences_are_not_compared_with_those_of_another_release(
    vru_sample, sample, tmp_path
):
    for path in vru_sample.glob("*_tracks.json"):
        shutil.copy(path, tmp_path)
    assert ImptcVruDataset(tmp_path).scenes()
    with pytest.raises(ConversionError, match=r"`src_info.txt` must tell .*`other_release`"):
        ImptcVruDataset(tmp_path, sequences=ImptcDataset(sample)).scenes()


def test_the_other_release_is_given_by_its_folder(sample):
    assert sequences_at(None) is None
    assert sequences_at(str(sample)) == ImptcDataset(sample)


def test_mixed_recordings_take_the_split_of_their_sequence(vru_sample, sample):
    sequences = ImptcDataset(sample)
    found = ImptcVruDataset(vru_sample, sequences=sequences).overlaps(sequences)
    assert found
    assert all(overlap.vru_split == overlap.sequence_split for overlap in found)


def test_a_track_never_stands_in_different_splits_of_both_releases(vru_sample, sample, tmp_path):
    root = tmp_path / "published_as_test"
    for path in vru_sample.glob("*/*/track.json"):
        name = f"{path.parents[1].name}_{path.parent.name}"
        shutil.copytree(path.parent, root / "test" / name)
    for empty in ("train", "eval"):
        (root / empty).mkdir()
    sequences = ImptcDataset(sample)
    joined = ImptcVruDataset(root, sequences=sequences)
    conflicts = [o for o in joined.overlaps(sequences) if o.vru_split != o.sequence_split]
    report = convert(ConversionSettings(joined, tmp_path, strict=True, progress=False))
    assert report.rejected_by_reason == {"source_sequence_in_another_split": len(conflicts)}
    assert len(report.dataset_notes["overlaps_in_other_split"]) == len(conflicts) > 0
    tables = {path.parent.name: pd.read_feather(path) for path in tmp_path.glob("*/*/agent*")}
    kept = {
        agent: scene.split
        for scene in report.scenes
        if scene.usable
        for agent in tables[scene.name]["agent_id"].unique()
    }
    for overlap in joined.overlaps(sequences):
        own = kept.get(overlap.track.replace("/", "_"), overlap.sequence_split)
        assert own == overlap.sequence_split


def test_overlaps_name_the_sequence_and_the_vru(vru_sample, sample):
    overlap = ImptcVruDataset(vru_sample).overlaps(ImptcDataset(sample))[0]
    stamp, vru = overlap.source.split("/")
    assert overlap.sequence.endswith(stamp)
    assert (sample / overlap.sequence / "vrus" / vru / "track.json").is_file()


@pytest.mark.parametrize("absent", ["train", "eval", "test"])
def test_an_incomplete_vru_release_is_refused(vru_sample, tmp_path, absent):
    for name in {"train", "eval", "test"} - {absent}:
        (tmp_path / name).symlink_to(vru_sample / name)
    with pytest.raises(ConversionError, match=f"no.*{absent}"):
        ImptcVruDataset(tmp_path).scenes()


@pytest.mark.parametrize(
    ("dataset", "source"), [(ImptcDataset, "sample"), (ImptcVruDataset, "vru_sample")]
)
def test_an_edit_that_leaves_the_size_of_a_file_is_seen(dataset, source, request, tmp_path):
    root = tmp_path / "copy"
    shutil.copytree(request.getfixturevalue(source), root)
    before = dataset(root).scenes()
    path = next(root.glob("*/*/*/track.json" if dataset is ImptcDataset else "train/*/track.json"))
    text = path.read_text()
    path.write_text(text[:-1].replace("1", "2", 1) + text[-1])
    changed = [
        old.name for old, new in zip(before, dataset(root).scenes(), strict=True) if old != new
    ]
    assert len(changed) == 1


@pytest.mark.parametrize("name", ["imptc", "dataset_imptc"])
def test_of_repeated_sequences_that_of_a_set_is_taken_whatever_the_root_is_called(tmp_path, name):
    for folder in ("samples/0000_20230322_120000", "set_05/0203_20230322_120000"):
        (tmp_path / name / folder).mkdir(parents=True)
    assert list(find_sequences(tmp_path / name)) == ["0203_20230322_120000"]
