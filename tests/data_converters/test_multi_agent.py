"""ETH/UCY, CITR, DUT and SDD: axes, clocks, splits, faults, and the real data."""

import gzip
import shutil

import numpy as np
import pandas as pd
import pytest

from data_converters import (
    AutobikeDataset,
    CitrDataset,
    ConversionError,
    ConversionSettings,
    DutDataset,
    EthUcyDataset,
    Mode,
    RejectReason,
    ResampleSettings,
    SddDataset,
    Unsmoothed,
    convert,
)
from tests.data_converters.synthetic import WRITERS, ride, times, zipped

DATA_SETS = {
    "autobike": AutobikeDataset,
    "citr": CitrDataset,
    "dut": DutDataset,
    "eth_ucy": EthUcyDataset,
    "sdd": SddDataset,
}
BENCHMARK = ResampleSettings(dt_s=0.4, min_duration_s=0.4, smoother=Unsmoothed())


@pytest.fixture
def written(tmp_path):
    """Write the made-up recordings of a data set and describe them."""

    def build(name, **options):
        WRITERS[name](tmp_path / name)
        return DATA_SETS[name](tmp_path / name, **options)

    return build


def read(dataset, number=0):
    return dataset.read(dataset.scenes()[number], 0.1, strict=True)


@pytest.mark.parametrize(
    ("name", "modes"),
    [
        ("citr", {"ped_0": Mode.PEDESTRIAN, "ped_1": Mode.PEDESTRIAN, "veh_0": Mode.CART}),
        ("dut", {"ped_0": Mode.PEDESTRIAN, "ped_1": Mode.PEDESTRIAN, "veh_0": Mode.CAR}),
        ("eth_ucy", {f"ped_{number}": Mode.PEDESTRIAN for number in range(3)}),
        (
            "sdd",
            {"agent_0": Mode.BICYCLE, "agent_1": Mode.PEDESTRIAN, "agent_2": Mode.SKATEBOARD},
        ),
    ],
)
def test_all_agents_of_a_recording_are_in_one_scene(written, name, modes):
    raw = read(written(name))
    assert {track.name: track.mode for track in raw.tracks} == modes
    assert {track.time_s[0] for track in raw.tracks} == {0.0}


@pytest.mark.parametrize(("name", "rate_hz"), [("citr", 29.97), ("dut", 23.98), ("sdd", 30.0)])
def test_pictures_are_turned_up_so_that_left_stays_left(written, name, rate_hz):
    track = read(written(name)).tracks[0]
    time_s = times(rate_hz)[: len(track.time_s)]
    np.testing.assert_allclose(track.time_s, time_s, atol=1e-9)
    np.testing.assert_allclose(
        track.position[:, :2], ride(times(rate_hz), 0.0).position[: len(time_s)], atol=1e-3
    )


@pytest.mark.parametrize("name", ["citr", "dut"])
def test_the_heading_of_a_vehicle_follows_its_motion_from_the_first_row_on(written, name, tmp_path):
    convert(ConversionSettings(written(name), tmp_path / "cache", progress=False))
    table = pd.read_feather(next((tmp_path / "cache").glob(f"{name}/*/agent_data*.feather")))
    rows = table[table["agent_id"] == "veh_0"]
    course = np.arctan2(rows["vy"], rows["vx"])
    assert np.abs(np.angle(np.exp(1j * (rows["heading"] - course)))).max() < 0.15


@pytest.mark.parametrize("name", ["citr", "dut", "sdd"])
def test_every_split_gets_a_whole_recording(written, name):
    assert {scene.split for scene in written(name).scenes()} == {"train", "val", "test"}


def test_both_cuts_of_a_recording_name_it(written):
    told = {scene.name: scene.recording for scene in written("eth_ucy").scenes()}
    assert told == {"biwi_eth": "", "a_train": "a", "a_val": "a"}


def test_tracks_before_the_filter_are_pixels_with_a_scale(written):
    root = written("dut").root
    table = pd.DataFrame({"id": 0, "x": 28.0 * times(23.98), "y": 14.0, "frame": range(264)})
    zipped(root / "raw" / "crossing_04_ped.csv.gz", table.to_csv(index=False))
    refused = DutDataset(root).read(DutDataset(root).scenes()[3], 0.1, strict=False).rejected
    assert [item.reason for item in refused] == [RejectReason.SCALE]
    (root / "ratios.csv").write_text("clip,pixels_per_metre\ncrossing_04,28.0\n")
    track = read(DutDataset(root), 3).tracks[0]
    np.testing.assert_allclose(track.position[-1], [263 / 23.98, -0.5, 0.0])


def test_what_is_seen_after_being_lost_is_another_agent(written):
    dataset = written("sdd")
    rows = [f'7 0 0 10 10 {frame} {int(40 <= frame < 45)} 0 0 "Cart"' for frame in range(90)]
    path = dataset.root / "gates" / "video0" / "annotations.txt.gz"
    path.write_bytes(gzip.compress("\n".join(rows).encode()))
    raw = read(dataset)
    assert [(track.name, len(track.time_s)) for track in raw.tracks] == [
        ("agent_7", 40),
        ("agent_7_v1", 45),
    ]
    assert raw.notes["rows_lost"] == 5


@pytest.mark.parametrize(
    ("certainty", "options", "reasons"),
    [
        (0.0, {}, [RejectReason.LOW_CERTAINTY]),
        (0.49, {}, [RejectReason.LOW_CERTAINTY]),
        (0.5, {}, []),
        (0.0, {"min_certainty": 0.0}, []),
    ],
)
def test_a_guessed_scale_is_refused_unless_it_is_asked_for(written, certainty, options, reasons):
    dataset = written("sdd")
    scales = dataset.root / "scales.csv"
    scales.write_text(scales.read_text().replace("video1,0.04,1.0", f"video1,0.04,{certainty}"))
    dataset = SddDataset(dataset.root, **options)
    raw = dataset.read(dataset.scenes()[1], 0.1, strict=False)
    assert [item.reason for item in raw.rejected] == reasons


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        ("790\t9\tx\t1\n800\t9\t1\t1\n", RejectReason.NOT_FINITE),
        ("790\t9\t1\t1\n790\t9\t1\t2\n", RejectReason.REPEATED_TIMESTAMPS),
    ],
)
def test_a_bad_row_costs_its_agent_alone(written, bad, reason):
    dataset = written("eth_ucy")
    path = dataset.root / "all_data" / "biwi_eth.txt.gz"
    path.write_bytes(gzip.compress(gzip.decompress(path.read_bytes()) + b"\n" + bad.encode()))
    raw = dataset.read(dataset.scenes()[0], 0.4, strict=False)
    assert [(item.track, item.reason) for item in raw.rejected] == [("ped_9", reason)]
    assert len(raw.tracks) == 3


def test_boxes_without_a_number_cost_no_agent_that_has_one(written):
    dataset = written("sdd")
    path = dataset.root / "gates" / "video0" / "annotations.txt.gz"
    torn = [f'x 0 0 10 10 {frame} {int(frame == 2)} 0 0 "Cart"' for frame in range(4)]
    zipped(path, "\n".join([gzip.decompress(path.read_bytes()).decode(), *torn]))
    raw = dataset.read(dataset.scenes()[0], 0.1, strict=False)
    assert [track.name for track in raw.tracks] == ["agent_0", "agent_1", "agent_2"]
    assert {item.track: item.reason for item in raw.rejected} == {
        "agent_nan": RejectReason.NOT_FINITE,
        "agent_nan_v1": RejectReason.NOT_FINITE,
    }


@pytest.mark.parametrize("damage", [lambda b: b[:40], lambda b: b"\x1f\x8b" + b[9:], lambda b: b""])
@pytest.mark.parametrize("name", ["citr", "eth_ucy", "sdd"])
def test_a_damaged_file_is_counted_and_the_others_kept(written, name, damage, tmp_path):
    dataset = written(name)
    path = sorted(dataset.root.rglob("*.gz"))[-1]
    path.write_bytes(damage(path.read_bytes()))
    report = convert(ConversionSettings(dataset, tmp_path / "cache", progress=False))
    assert report.rejected_by_reason == {RejectReason.MISSING_FIELD: 1}


@pytest.mark.parametrize(
    ("name", "file", "copy"),
    [
        ("autobike", "recordings/09_06/1.csv.gz", "recordings/09_06/1.csv"),
        ("autobike", "recordings/09_06/1.csv.gz", "recordings/09_06/data_1.csv.gz"),
        ("autobike", "recordings/09_06/1.csv.gz", "old/Test_session_09_06/1.csv.gz"),
        ("citr", "filtered/crossing_01_ped.csv.gz", "filtered/crossing_01_ped.csv"),
        ("dut", "filtered/crossing_01_veh.csv.gz", "filtered/crossing-01_veh.csv.gz"),
        ("eth_ucy", "all_data/biwi_eth.txt.gz", "all_data/biwi_eth.txt"),
        ("eth_ucy", "train/a_train.txt.gz", "train/a_val.txt.gz"),
        ("sdd", "gates/video0/annotations.txt.gz", "gates/video0/annotations.txt"),
    ],
)
def test_no_file_takes_the_place_of_another_in_silence(written, name, file, copy):
    root = written(name).root
    (root / copy).parent.mkdir(parents=True, exist_ok=True)
    (root / copy).write_bytes(b"other rows")
    with pytest.raises(ConversionError, match="`file` must not name recording") as caught:
        DATA_SETS[name](root).scenes()
    # the one stands with its folder, and so does the other
    for path in (root / file, root / copy):
        assert path.name in str(caught.value)
        assert str(path.parent) in str(caught.value)


@pytest.mark.parametrize("name", ["citr", "eth_ucy", "sdd"])
def test_agents_of_large_numbers_are_apart(written, name):
    dataset = written(name)
    before = [track.position for track in read(dataset).tracks]
    for path in dataset.root.rglob("*.gz"):
        first, *lines = gzip.decompress(path.read_bytes()).decode().split("\n")
        if name == "citr":
            changed = [first] + [f"123456789{line}" if line else line for line in lines]
        elif name == "sdd":
            changed = [f"123456789{line}" for line in (first, *lines)]
        else:
            changed = [line.replace("\t", "\t123456789", 1) for line in (first, *lines)]
        zipped(path, "\n".join(changed))
    raw = read(dataset)
    assert {track.name.split("_")[1][:9] for track in raw.tracks} == {"123456789"}
    for track, position in zip(raw.tracks, before, strict=True):
        np.testing.assert_array_equal(track.position, position)


def test_a_clip_with_a_hyphen_keeps_its_files_together_and_its_scale(written):
    root = written("dut").root
    rows = pd.DataFrame({"id": 0, "x": 28.0 * times(23.98), "y": 14.0, "frame": range(264)})
    zipped(root / "raw" / "crossing-01_ped.csv.gz", rows.to_csv(index=False))
    (root / "ratios.csv").write_text("clip,pixels_per_metre\ncrossing-01,28.0\n")
    scenes = DutDataset(root, unfiltered=True).scenes()
    assert [scene.name for scene in scenes] == ["crossing_01", "crossing_02", "crossing_03"]
    walk, drive = read(DutDataset(root, unfiltered=True)).tracks
    np.testing.assert_allclose(walk.position[-1], [263 / 23.98, -0.5, 0.0])
    assert drive.mode is Mode.CAR


@pytest.mark.parametrize("blank", [" ", "  ", "\t"])
def test_any_blanks_part_the_columns_of_boxes(written, blank):
    dataset = written("sdd")
    before = [track.position for track in read(dataset).tracks]
    path = dataset.root / "gates" / "video0" / "annotations.txt.gz"
    zipped(path, gzip.decompress(path.read_bytes()).decode().replace(" ", blank))
    for track, position in zip(read(dataset).tracks, before, strict=True):
        np.testing.assert_array_equal(track.position, position)


def test_a_video_in_which_everybody_is_lost_costs_no_other(written, tmp_path):
    dataset = written("sdd")
    path = dataset.root / "gates" / "video0" / "annotations.txt.gz"
    zipped(path, gzip.decompress(path.read_bytes()).decode().replace(" 0 0 1 ", " 1 0 1 "))
    report = convert(ConversionSettings(dataset, tmp_path / "cache", progress=False))
    assert report.rejected_by_reason == {RejectReason.TOO_SHORT: 1}
    assert report.totals()["scenes"] == 2


def test_every_file_of_a_part_belongs_to_it(written):
    root = written("eth_ucy").root
    for name in ("train/biwi_hotel", "val/biwi_hotel_train", "val/biwi_eth", "train/biwi_eth_val"):
        zipped(root / f"{name}.txt.gz", "780 1 0 0")
    told = {scene.name: (scene.split, scene.recording) for scene in EthUcyDataset(root).scenes()}
    assert told == {
        "biwi_eth": ("test", ""),
        "a_train": ("train", "a"),
        "biwi_hotel_train": ("train", "biwi_hotel"),
        "a_val": ("val", "a"),
        "biwi_hotel_val": ("val", "biwi_hotel"),
    }


@pytest.mark.parametrize(
    ("removed", "absent"), [("train", "train"), ("val", "val"), ("all_data", "biwi_eth")]
)
def test_a_benchmark_that_is_not_whole_is_refused(written, removed, absent):
    root = written("eth_ucy").root
    shutil.rmtree(root / removed)
    with pytest.raises(ConversionError, match=rf"`root` must hold.*nothing for \['{absent}'\]"):
        EthUcyDataset(root).scenes()


def test_a_test_scene_of_two_recordings_needs_both(written):
    root = written("eth_ucy").root
    zipped(root / "all_data" / "students001.txt.gz", "780 1 0 0")
    with pytest.raises(ConversionError, match=r"nothing for \['students003'\]"):
        EthUcyDataset(root, held_out="univ").scenes()


@pytest.mark.parametrize(
    ("place", "found"), [("", "nothing of the kind"), ("no", "no such folder")]
)
@pytest.mark.parametrize("name", DATA_SETS)
def test_a_folder_without_recordings_is_told(name, place, found, tmp_path):
    with pytest.raises(ConversionError, match=f"`root` must hold .*'{found}'"):
        DATA_SETS[name](tmp_path / place).scenes()


def test_an_unknown_scene_to_hold_out_is_refused(tmp_path):
    with pytest.raises(ConversionError, match="`held_out` must be one of eth, hotel, univ"):
        EthUcyDataset(tmp_path, held_out="zara3")


@pytest.mark.parametrize(
    ("held_out", "test"), [("eth", {"biwi_eth"}), ("univ", {"students001", "students003"})]
)
def test_the_real_scene_held_out_takes_no_part_in_training(shared, held_out, test):
    scenes = EthUcyDataset(shared / "data" / "eth_ucy", held_out=held_out).scenes()
    splits = pd.read_csv(shared / "data" / "eth_ucy" / "splits.csv")
    published = splits[splits["scene"] == held_out]
    for part, named in published.groupby("part"):
        names = {name.removesuffix(".txt") for name in named["name"]}
        assert names == {scene.name for scene in scenes if scene.split == part}
    assert test == {scene.name for scene in scenes if scene.split == "test"}


def test_the_benchmark_has_as_many_windows_as_published(shared, tmp_path):
    root = tmp_path / "eth_ucy"
    for part, name in (
        ("all_data", "biwi_eth"),
        ("train", "uni_examples_train"),
        ("val", "uni_examples_val"),
    ):
        (root / part).mkdir(parents=True)
        source = shared / "data" / "eth_ucy" / part / f"{name}.txt.gz"
        (root / part / source.name).symlink_to(source)
    convert(ConversionSettings(EthUcyDataset(root), tmp_path, BENCHMARK, progress=False))
    path = tmp_path / "eth_ucy_eth" / "biwi_eth" / "agent_data_dt0.40.feather"
    table = pd.read_feather(path).sort_values(["agent_id", "scene_ts"])
    rows = table.groupby("agent_id").size()
    assert (rows - 19).clip(lower=0).sum() == 364
    assert len(rows) == 360
    # constant velocity of the last step over 12 steps, as measured for all 364 windows
    errors = []
    for _, track in table.groupby("agent_id"):
        xy, velocity = track[["x", "y"]].to_numpy(), track[["vx", "vy"]].to_numpy()
        for now in range(7, len(track) - 12):
            ahead = 0.4 * np.arange(1, 13)[:, None]
            off = xy[now] + ahead * velocity[now] - xy[now + 1 : now + 13]
            errors.append(np.linalg.norm(off, axis=1))
    assert np.mean(errors) == pytest.approx(1.08, abs=0.01)
    assert np.mean([error[-1] for error in errors]) == pytest.approx(2.28, abs=0.01)


@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("citr", ["filtered/front_interaction_01_ped", "filtered/front_interaction_01_veh"]),
        ("dut", ["filtered/intersection_03_ped", "filtered/intersection_03_veh"]),
    ],
)
def test_a_real_clip_has_people_around_a_vehicle(shared, tmp_path, name, files):
    for file in files:
        source = shared / "data" / name / f"{file}.csv.gz"
        target = tmp_path / f"{file}.csv.gz"
        target.parent.mkdir(exist_ok=True)
        target.symlink_to(source)
    raw = read(DATA_SETS[name](tmp_path))
    counts = {mode: sum(track.mode is mode for track in raw.tracks) for mode in Mode}
    assert counts[Mode.PEDESTRIAN] >= 5
    assert counts[Mode.CART if name == "citr" else Mode.CAR] >= 1
