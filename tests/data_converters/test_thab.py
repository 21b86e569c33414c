"""TH-AB tracks: reading, duplicates, split by recording, and the real data."""

import re
import shutil
import tarfile

import numpy as np
import pandas as pd
import pytest

from data_converters import (
    CausalSmoother,
    ConversionError,
    ConversionSettings,
    Mode,
    RejectReason,
    ResampleSettings,
    ThabVruDataset,
    TrackError,
    convert,
    open_cache,
)
from data_converters.thab.duplicates import find_contained, group_recordings
from data_converters.thab.reader import ThabFile, parse


def walk(seed, count=40):
    return np.round(np.cumsum(np.random.default_rng(seed).normal(size=(count, 2)), axis=0), 2)


def test_archives_and_folders_hold_the_same_tracks(thab, tmp_path):
    packed = tmp_path / "packed"
    packed.mkdir()
    with tarfile.open(packed / "cyclists.tar.gz", "w:gz") as tar:
        tar.add(thab / "cyclists", arcname="cyclists")
    assert ThabVruDataset(packed).scenes() == ThabVruDataset(thab).scenes()


@pytest.mark.parametrize("inside", ["", "moving", "cyclists/moving"])
def test_an_archive_is_read_although_a_folder_without_files_lies_beside_it(thab, tmp_path, inside):
    with tarfile.open(tmp_path / "cyclists.tar.gz", "w:gz") as tar:
        tar.add(thab / "cyclists", arcname="cyclists")
    (tmp_path / "cyclists" / inside).mkdir(parents=True)
    assert ThabVruDataset(tmp_path).scenes() == ThabVruDataset(thab).scenes()


@pytest.mark.parametrize(
    ("name", "packed"),
    [
        ("cyclists/moving/7.csv.gz", False),
        ("cyclists/turning/7.csv", False),
        ("scooters/moving/7.csv", False),
        ("cyclists/moving/7.csv.gz", True),
        ("cyclists/turning/7.csv", True),
    ],
)
def test_tables_that_are_not_read_are_told(thab, tmp_path, caplog, name, packed):
    root = tmp_path / "root"
    shutil.copytree(thab, root)
    ThabVruDataset(root).scenes()
    assert caplog.text == ""
    (root / name).parent.mkdir(parents=True, exist_ok=True)
    (root / name).write_bytes(b"")
    if packed:
        with tarfile.open(root / "cyclists.tar.gz", "w:gz") as tar:
            tar.add(root / "cyclists", arcname="cyclists")
        shutil.rmtree(root / "cyclists")
    ThabVruDataset(root).scenes()
    told = f"Files that are not read: 1, the first: .*{name}. Read are .cyclists.pedestrians./"
    assert re.search(told, caplog.text)


def test_a_group_without_files_is_not_left_out_in_silence(thab, tmp_path):
    (tmp_path / "cyclists").symlink_to(thab / "cyclists")
    (tmp_path / "pedestrians" / "pedestrians" / "moving").mkdir(parents=True)
    told = r"`pedestrians` must hold files such as moving/1.csv .*, but got 'none' in .*pedestrians"
    with pytest.raises(ConversionError, match=told):
        ThabVruDataset(tmp_path).scenes()


def test_a_cut_off_archive_is_named(thab, tmp_path):
    with tarfile.open(tmp_path / "cyclists.tar.gz", "w:gz") as tar:
        tar.add(thab / "cyclists", arcname="cyclists")
    path = tmp_path / "cyclists.tar.gz"
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ConversionError, match="whole.*cyclists.tar.gz"):
        ThabVruDataset(tmp_path).scenes()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", RejectReason.MISSING_FIELD),
        (",x,y\n0,1,2\n", RejectReason.NO_TIMESTAMPS),
        (",timestamp,x\n0,1,2\n", RejectReason.MISSING_FIELD),
        (",timestamp,x,y\n0,0.0,nan,2\n1,0.1,1,2\n", RejectReason.NOT_FINITE),
        (",timestamp,x,y\n0,0.0,one,2\n1,0.1,1,2\n", RejectReason.NOT_FINITE),
        (",timestamp,x,y\n0,0.0,1,2\n1,0.0,1,2\n", RejectReason.REPEATED_TIMESTAMPS),
    ],
)
def test_a_faulty_file_is_refused_with_its_name(text, reason):
    with pytest.raises(TrackError, match="cyclists/moving/1.csv") as caught:
        parse(ThabFile("cyclists", "moving", "1", text.encode()))
    assert caught.value.reason is reason


@pytest.mark.parametrize("row", [0, 2])
def test_the_row_of_a_value_that_is_none_is_told(row) -> None:
    lines = [f"{each},{each},1,{'nan' if each == row else 2}" for each in range(3)]
    text = "\n".join([",timestamp,x,y", *lines]).encode()
    with pytest.raises(TrackError, match=f"nan.*cyclists/moving/1.csv, row {row}"):
        parse(ThabFile("cyclists", "moving", "1", text))


@pytest.mark.parametrize(("folder", "found"), [("", "none of them"), ("no", "no such folder")])
def test_a_folder_of_something_else_is_told_from_none(tmp_path, folder, found) -> None:
    told = rf"`root` must hold cyclists/ or cyclists.tar.gz, .*, but got '{found}' in "
    with pytest.raises(ConversionError, match=told):
        ThabVruDataset(tmp_path / folder).scenes()


@pytest.mark.parametrize("stamps", [[0.0], [5.0], [1.0, 2.0], [2.0, 1.0, 3.0]])
def test_a_file_of_any_length_is_read_as_it_is(stamps) -> None:
    lines = [f"{row},{stamp},{row},-{row}" for row, stamp in enumerate(stamps)]
    text = "\n".join([",timestamp,x,y", *lines]).encode()
    values = parse(ThabFile("cyclists", "moving", "1", text))
    rows = np.arange(len(stamps))
    np.testing.assert_array_equal(values, np.column_stack([stamps, rows, -rows]))


def test_a_file_with_another_fault_is_read_again(thab, thab_settings):
    path, header = thab / "cyclists" / "moving" / "21.csv", ",timestamp,x,y"
    reasons = []
    for text in ("", f"{header}\n", f"{header}\n0,0.0,1,nan\n1,0.1,1,2\n"):
        path.write_text(text)
        (scene,) = (s for s in convert(thab_settings()).scenes if s.name == "cyclists_moving_21")
        reasons += [item["reason"] for item in scene.rejected]
    assert reasons == ["missing_field", "too_short", "coordinates_not_finite"]


def test_a_file_from_the_end_to_the_beginning_is_put_in_order(thab):
    path = thab / "cyclists" / "moving" / "21.csv"
    tracks = []
    for _ in range(2):
        dataset = ThabVruDataset(thab)
        scene = next(each for each in dataset.scenes() if each.name == "cyclists_moving_21")
        tracks.append(dataset.read(scene, 0.1, strict=True).tracks[0])
        header, *rows = path.read_text().split()
        path.write_text("\n".join([header, *reversed(rows)]))
    for name in ("time_s", "position"):
        np.testing.assert_array_equal(getattr(tracks[0], name), getattr(tracks[1], name))


def test_a_track_begins_at_zero_and_holds_the_first_of_samples_at_one_time(thab):
    rows = [(5.0, 1, 2), (5.1, 3, 4), (5.1, 5, 6), (5.3, 7, 8)]
    lines = [f"{row},{stamp},{x},{y}" for row, (stamp, x, y) in enumerate(rows)]
    text = "\n".join([",timestamp,x,y", *lines])
    (thab / "cyclists" / "moving" / "21.csv").write_text(text)
    dataset = ThabVruDataset(thab)
    scene = next(each for each in dataset.scenes() if each.name == "cyclists_moving_21")
    raw = dataset.read(scene, 0.1, strict=True)
    np.testing.assert_allclose(raw.tracks[0].time_s, [0.0, 0.1, 0.3])
    np.testing.assert_array_equal(raw.tracks[0].position, [[1, 2, 0], [3, 4, 0], [7, 8, 0]])
    assert raw.notes == {"repeated_timestamps": 1}


@pytest.mark.parametrize(
    "piece", [slice(0, 15), slice(10, 25), slice(20, 40), slice(30, 40), slice(0, 40)]
)
def test_a_file_cut_out_of_another_is_contained_in_it(piece):
    long, other = walk(0), walk(1)
    assert find_contained({"a": long, "b": long[piece], "c": other}) == {"b": "a"}


@pytest.mark.parametrize("start", [5, 20])
def test_a_file_that_only_begins_like_a_part_of_another_is_kept(start) -> None:
    track = walk(0)
    assert (
        find_contained({"a": track, "b": np.vstack([track[start : start + 15], walk(1)[:5]])}) == {}
    )


@pytest.mark.parametrize(
    ("name", "group"), [("100021", "21"), ("100099", "100099"), ("21_7", "21")]
)
def test_a_name_tells_the_recording(thab, name, group) -> None:
    moving = thab / "cyclists" / "moving"
    track = pd.read_csv(moving / "21.csv", index_col=0)
    track.assign(x=track["x"] + 50.0).to_csv(moving / f"{name}.csv")
    told = {scene.key: scene.recording for scene in ThabVruDataset(thab).scenes()}
    assert told[f"cyclists/moving/{name}.csv"] == f"cyclists/{group}"


@pytest.mark.parametrize(("noise_m", "held"), [(0.0, {"b": "a"}), (0.004, {"b": "a"}), (0.006, {})])
def test_samples_repeat_others_if_equal_to_the_centimetre(noise_m, held) -> None:
    track = walk(0)
    assert find_contained({"a": track, "b": track[5:30] - noise_m}) == held


@pytest.mark.parametrize(("count", "held"), [(9, {}), (10, {"b": "a"})])
@pytest.mark.parametrize("end", [10, 25, 40])
def test_fewer_than_ten_samples_may_agree_by_chance(end, count, held) -> None:
    track = walk(0)
    assert find_contained({"a": track, "b": track[end - count : end]}) == held


@pytest.mark.parametrize("last", [True, False])
@pytest.mark.parametrize(("count", "groups"), [(9, {"1", "2"}), (10, {"1"}), (15, {"1"})])
def test_ten_shared_samples_make_one_recording(last, count, groups) -> None:
    shared = walk(2, count)
    pairs = {name: [walk(seed), shared] for seed, name in enumerate("ab")}
    tracks = {name: np.concatenate(pair if last else pair[::-1]) for name, pair in pairs.items()}
    assert set(group_recordings(tracks, {"a": "1", "b": "2"}).values()) == groups


@pytest.mark.parametrize(
    ("names", "groups"),
    [
        ({"a": "1", "b": "2", "c": "3"}, {"a": "1", "b": "1", "c": "3"}),
        ({"a": "1", "b": "2", "c": "2"}, {"a": "1", "b": "1", "c": "1"}),
    ],
    ids=["shared samples", "shared samples and a shared name"],
)
def test_files_that_only_overlap_are_not_contained_but_one_recording(names, groups):
    long = walk(0, 60)
    tracks = {"a": long[:40], "b": long[25:], "c": walk(1)}
    assert find_contained(tracks) == {}
    assert group_recordings(tracks, names) == groups


def test_no_recording_stands_in_two_splits(thab):
    dataset = ThabVruDataset(thab)
    groups = dataset._index.groups
    splits = {scene.key: scene.split for scene in dataset.scenes()}
    for group in set(groups.values()):
        assert len({splits[path] for path in groups if groups[path] == group}) == 1


def test_the_split_depends_on_names_and_salt_only(thab):
    def splits(**options):
        return [scene.split for scene in ThabVruDataset(thab, **options).scenes()]

    assert splits() == splits()
    assert splits(salt="other") != splits()
    assert splits(shares=(0.0, 0.0, 1.0)).count("test") >= 12


@pytest.mark.parametrize("shares", [(0.5, 0.5, 0.5), (1.2, -0.1, -0.1)])
def test_shares_must_add_up(tmp_path, shares):
    with pytest.raises(ConversionError, match="shares"):
        ThabVruDataset(tmp_path, shares=shares)


@pytest.fixture(scope="module")
def cyclists(shared, tmp_path_factory):
    """The real cyclists alone: pedestrians are converted only where it makes a difference."""
    raw = tmp_path_factory.mktemp("raw")
    (raw / "cyclists.tar.gz").symlink_to(shared / "data" / "thab_vru" / "cyclists.tar.gz")
    return raw


@pytest.fixture(scope="module")
def real(cyclists, tmp_path_factory):
    """The real tracks of cyclists, converted."""
    cache = tmp_path_factory.mktemp("real")
    return convert(
        ConversionSettings(ThabVruDataset(cyclists), cache, workers=2, progress=False)
    ), cache


@pytest.fixture(scope="module")
def everybody(shared):
    """The real tracks of all, as they are split."""
    return ThabVruDataset(shared / "data" / "thab_vru")


@pytest.mark.slow
def test_the_known_faults_of_the_real_tracks_are_found(everybody, tmp_path):
    report = convert(ConversionSettings(everybody, tmp_path, workers=2, progress=False))
    assert report.rejected_by_reason["contained_in_another_file"] == 79
    assert report.rejected_by_reason["repeated_timestamps"] == 1
    assert report.totals()["tracks_read"] == 936
    counts = np.array([report.agents()[split]["pedestrian"] for split in ("train", "val", "test")])
    np.testing.assert_allclose(counts / counts.sum(), [0.70, 0.15, 0.15], atol=0.02)


def test_what_is_converted_of_the_real_split_has_its_shares(real):
    counts = np.array([real[0].agents()[split]["bicycle"] for split in ("train", "val", "test")])
    np.testing.assert_allclose(counts / counts.sum(), [0.70, 0.15, 0.15], atol=0.02)


@pytest.mark.parametrize("kind", ["cyclists", "pedestrians"])
def test_the_real_split_has_its_shares(everybody, kind):
    splits = [scene.split for scene in everybody.scenes() if scene.key.startswith(kind)]
    counts = np.array([splits.count(split) for split in ("train", "val", "test")])
    np.testing.assert_allclose(counts / counts.sum(), [0.70, 0.15, 0.15], atol=0.02)


@pytest.mark.parametrize(("direction", "known"), [("along_m", 0.08), ("across_m", 0.055)])
def test_the_residual_on_real_cyclists_is_their_known_noise(real, direction, known):
    assert real[0].residual_m["bicycle"][direction] == pytest.approx(known, abs=0.015)


def test_real_cyclists_ride_at_plausible_speeds_and_accelerations(real):
    cache = real[1]
    tables = [pd.read_feather(p) for p in cache.glob("thab_vru/cyclists*/agent_data*.feather")]
    rows = pd.concat(tables)
    speed, pull = np.hypot(rows.vx, rows.vy), np.hypot(rows.ax, rows.ay)
    assert speed[speed > 0.5].median() == pytest.approx(2.7, abs=0.3)
    assert pull[speed > 0.5].quantile(0.95) < 3.5


def test_no_run_of_real_samples_stands_in_two_splits(everybody):
    owner = {}
    for scene in everybody.scenes():
        samples = everybody._index.samples.get(scene.key, np.zeros((0, 3)))[:, 1:]
        for start in range(0, len(samples) - 12, 3):
            run = samples[start : start + 12].tobytes()
            assert owner.setdefault(run, scene.split) == scene.split


def test_real_windows_are_iterated(real):
    dataset = open_cache(
        real[1],
        {"thab_vru": ["test"]},
        history_sec=(4.0, 4.0),
        future_sec=(3.0, 3.0),
        only_predict=[Mode.BICYCLE],
    )
    assert len(dataset) == real[0].windows()["test"]["bicycle"]
    element = dataset[len(dataset) // 2]
    assert element.agent_history_np.shape == (41, 8)
    np.testing.assert_allclose(np.asarray(element.agent_history_np)[-1, :2], 0.0, atol=1e-9)


def test_the_causal_cache_of_real_cyclists_has_no_invalid_row(cyclists, tmp_path):
    resample = ResampleSettings(smoother=CausalSmoother())
    dataset = ThabVruDataset(cyclists)
    report = convert(ConversionSettings(dataset, tmp_path, resample, workers=2, progress=False))
    assert report.totals()["scenes"] > 200
    table = pd.concat(pd.read_feather(p) for p in tmp_path.glob("thab_vru/*/agent_data*.feather"))
    assert np.isfinite(table[["x", "y", "vx", "vy", "ax", "ay", "heading"]]).all().all()
