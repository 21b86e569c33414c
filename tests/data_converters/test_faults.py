"""Faults that once ended a conversion, or passed unseen: each is rejected, the rest converted."""

import gzip
import io
import json
import shutil
import tarfile

import numpy as np
import pytest

from benchmarks.faults.tables import ENDLESS
from data_converters import (
    ConversionError,
    ConversionSettings,
    ImptcDataset,
    ImptcVruDataset,
    RecordingLimits,
    ThabVruDataset,
    TwoWheelerDataset,
    convert,
    open_cache,
)
from data_converters.limits import SPEED_MAX_MPS, on_one_clock
from dmmv_conventions.modes import Mode

HEADER = ",timestamp,x,y\n"


def rows(time_s, x, y):
    return HEADER + "".join(
        f"{i},{t},{a},{b}\n" for i, (t, a, b) in enumerate(zip(time_s, x, y, strict=True))
    )


TIME = np.arange(0.0, 6.0, 0.08)
RIDE = rows(TIME, 3.0 * TIME, 0.0 * TIME)


def converted(dataset, cache):
    return convert(ConversionSettings(dataset, cache, progress=False))


@pytest.fixture
def cyclists(tmp_path):
    """A folder with one good ride; the report of it with a second file, and the agents kept."""
    folder = tmp_path / "raw" / "cyclists" / "moving"
    folder.mkdir(parents=True)
    (folder / "20.csv").write_text(RIDE)

    def convert_with(name, content):
        if isinstance(content, str):
            (folder / name).write_text(content)
        else:
            content(folder / name)
        report = converted(ThabVruDataset(tmp_path / "raw"), tmp_path / "cache")
        agents = sum(sum(scene.agents.values()) for scene in report.scenes)
        return report.rejected_by_reason, agents

    return convert_with


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (HEADER, "too_short"),
        (rows(TIME, 1e308 + 0 * TIME, 0 * TIME), "coordinates_beyond_limit"),
        (rows(TIME, 1e9 + TIME, 0 * TIME), "coordinates_beyond_limit"),
        (rows(TIME, 1000 * 3 * TIME, 5000 + 0 * TIME), "coordinates_beyond_limit"),
        (rows(TIME, 50 * 3 * TIME, 0 * TIME), "faster_than_its_mode"),
        (rows(TIME, 100 * 3 * TIME, 0 * TIME), "coordinates_beyond_limit"),
        (rows(TIME, 40 * TIME, 0 * TIME), "faster_than_its_mode"),
        (rows(TIME, 3 * TIME + 900 * (TIME > 3), 0 * TIME), "faster_than_its_mode"),
        (rows(TIME + 60 * (TIME > 3), 3 * TIME, 900 * (TIME > 3)), None),
        (rows(1000 * TIME, 3 * TIME, 0 * TIME), "unknown_timestamp_unit"),
        (rows(1e300 * TIME, 3 * TIME, 0 * TIME), "time_beyond_limit"),
        (rows(TIME + 3.2e7 * (TIME > 3), 3 * TIME, 0 * TIME), "time_beyond_limit"),
        (RIDE.replace(",x,y", ",x"), "missing_field"),
    ],
)
def test_a_track_that_cannot_be_is_rejected_and_the_rest_converted(cyclists, content, reason):
    rejected, agents = cyclists("21.csv", content)
    if reason is None:
        assert (rejected, agents) == ({}, 3)
    else:
        assert (rejected, agents) == ({reason: 1}, 1)


@pytest.mark.parametrize(
    "make",
    [lambda path: path.mkdir(), lambda path: path.symlink_to("nowhere.csv"), *ENDLESS.values()],
    ids=["a folder", "a dangling link", *ENDLESS],
)
def test_what_is_named_like_a_file_and_is_none_is_rejected(cyclists, make):
    assert cyclists("1.csv", make) == ({"unreadable_file": 1}, 1)


@pytest.mark.parametrize("name", ["a" * 250 + ".csv", "ü ö.csv", "..csv.csv", "1\n2.csv"])
def test_any_name_of_a_file_makes_a_scene(cyclists, name, tmp_path):
    assert cyclists(name, RIDE.replace("0.0\n", "1.0\n")) == ({}, 2)
    assert len(open_cache(tmp_path / "cache", {"thab_vru": ["train", "val", "test"]})) > 0


def test_files_whose_scenes_would_have_one_name_are_both_kept(cyclists, tmp_path):
    shutil.copy(
        tmp_path / "raw" / "cyclists" / "moving" / "20.csv",
        tmp_path / "raw" / "cyclists" / "moving" / "2-0.csv",
    )
    assert cyclists("2_0.csv", rows(TIME, 4 * TIME, 3 * TIME)) == (
        {"contained_in_another_file": 1},
        2,
    )


def tar_of(*members):
    """Bytes of a tar file of (name, content or target of a link)."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as tar:
        for name, content in members:
            member = tarfile.TarInfo(name)
            if isinstance(content, str):
                member.type, member.linkname = tarfile.SYMTYPE, content
                tar.addfile(member)
            else:
                member.size = len(content)
                tar.addfile(member, io.BytesIO(content))
    return stream.getvalue()


GOOD = ("cyclists/moving/20.csv", RIDE.encode())
OTHER = rows(TIME, 4.0 * TIME, 7.0 + 0.0 * TIME).encode()


@pytest.mark.parametrize(
    ("members", "reason"),
    [
        ([("cyclists/moving/1.csv", "nowhere.csv")], "unsafe_archive_member"),
        ([("cyclists/moving/1.csv", "1.csv")], "unsafe_archive_member"),
        ([("/cyclists/moving/1.csv", OTHER)], "unsafe_archive_member"),
        ([("../../moving/1.csv", OTHER)], "unsafe_archive_member"),
        ([("../1.csv", OTHER)], "unsafe_archive_member"),
        ([("cyclists/moving/20.csv", OTHER)], "repeated_file"),
    ],
)
def test_members_that_no_folder_could_hold_are_rejected(members, reason, tmp_path):
    (tmp_path / "cyclists.tar.gz").write_bytes(gzip.compress(tar_of(GOOD, *members)))
    report = converted(ThabVruDataset(tmp_path), tmp_path / "cache")
    assert report.rejected_by_reason == {reason: 1}
    assert report.totals()["scenes"] == 1


def broken_archives():
    tar = tar_of(GOOD, ("cyclists/moving/21.csv", OTHER))
    whole = gzip.compress(tar)
    second = tar.index(b"cyclists/moving/21.csv")
    yield "checksum", whole[:-8] + bytes(4) + whole[-4:]
    yield "length", whole[:-4] + bytes(4)
    yield "cut in the trailer", whole[:-3]
    yield "cut in the middle", whole[: len(whole) // 2]
    yield "a file is missing at the end", gzip.compress(tar[:second])
    yield "half a file is missing", gzip.compress(tar[: second + 1024])
    yield "empty", b""
    yield "text", b"no archive"
    yield "bits", whole[:200] + bytes([whole[200] ^ 255]) + whole[201:]


@pytest.mark.parametrize(("content"), [pytest.param(c, id=n) for n, c in broken_archives()])
def test_an_archive_that_is_not_whole_is_refused(content, tmp_path):
    (tmp_path / "cyclists.tar.gz").write_bytes(content)
    with pytest.raises(ConversionError, match="`archive` must be whole"):
        converted(ThabVruDataset(tmp_path), tmp_path / "cache")


BOX = "time_s,obj_id,x,y,z,qx,qy,qz,qw,sx,sy,sz\n"


def boxes(time_s, quaternion="0,0,0,1", x=1.0):
    return BOX + "".join(
        f"{t},0,{x},0,{3.0 * i},{quaternion},1,1,1\n" for i, t in enumerate(time_s)
    )


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (boxes([0.0]), "too_short"),
        (boxes([0.0] * 20), "too_short"),
        (boxes(np.arange(20) / 2, quaternion="0,0,0,0"), "no_orientation"),
        (boxes(np.arange(20) * 500.0), "time_beyond_limit"),
        (boxes(np.arange(20) * 1e300), "time_beyond_limit"),
        (boxes(np.arange(20) / 2, x=1e308), "coordinates_beyond_limit"),
        (None, "unreadable_file"),
    ],
)
def test_a_bad_ride_is_rejected_and_the_other_converted(content, reason, tmp_path):
    (tmp_path / "bicycle.csv").write_text(boxes(np.arange(20) / 2))
    if content is None:
        (tmp_path / "scooter.csv").mkdir()
    else:
        (tmp_path / "scooter.csv").write_text(content)
    report = converted(TwoWheelerDataset(tmp_path), tmp_path / "cache")
    assert report.rejected_by_reason == {reason: 1}
    assert report.totals()["scenes"] > 0


def test_a_ride_with_a_long_rest_is_converted_on_both_sides_of_it(tmp_path):
    time_s = np.concatenate([np.arange(20), np.arange(120, 140)]) / 2
    (tmp_path / "bicycle.csv").write_text(boxes(time_s))
    report = converted(TwoWheelerDataset(tmp_path), tmp_path / "cache")
    assert report.totals()["scenes"] == 2


@pytest.fixture
def sequence(sample, tmp_path):
    """A copy of one sequence; the report after a change to the content of one of its tracks."""
    raw = tmp_path / "raw"
    shutil.copytree(next(sample.rglob("0000_*")), raw / next(sample.rglob("0000_*")).name)
    files = sorted(raw.rglob("track.json"))

    def convert_with(change):
        content = json.loads(files[0].read_text())
        changed = change(content)
        files[0].write_text(changed if isinstance(changed, str) else json.dumps(content))
        report = converted(ImptcDataset(raw), tmp_path / "cache")
        return report, len(files)

    return convert_with


def shifted(seconds, share=1.0):
    def change(content):
        samples = list(content["track_data"].values())
        for sample in samples[: int(share * len(samples))]:
            stamp = int(sample["ts"])
            sample["ts"] = stamp + int(seconds * (1e6 if stamp > 1e14 else 1e3))

    return change


def first_of(**values):
    def change(content):
        next(iter(content["track_data"].values())).update(values)

    return change


def deep(content):
    return "[" * 100_000 + "]" * 100_000


YEAR_S = 365.0 * 86400.0


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (shifted(YEAR_S, share=0.5), "time_beyond_limit"),
        (shifted(-10 * YEAR_S), "time_beyond_limit"),
        (first_of(coordinates=[1e308, 1e308, 0.0]), "coordinates_beyond_limit"),
        (first_of(coordinates=[10**400, 0.0, 0.0]), "coordinates_not_finite"),
        (first_of(ts="9" * 5000), "no_timestamps"),
        (deep, "broken_json"),
        (lambda content: json.dumps(content | {"overview": {"class_id": float("inf")}}),
         "unknown_class_id"),
        (lambda content: '{"track_data": ' + "9" * 5000 + "}", "broken_json"),
    ],
)  # fmt: skip
def test_a_bad_track_is_rejected_and_its_scene_converted(sequence, change, reason):
    report, tracks = sequence(change)
    assert report.rejected_by_reason.get(reason) == 1
    assert report.totals()["tracks_read"] == tracks
    # 18 s on a clock of 0.1 s: nothing was made to reach the other year
    assert max(scene.steps for scene in report.scenes) < 300


def test_a_folder_of_a_track_without_its_file_is_counted(sequence, tmp_path):
    place = next((tmp_path / "raw").rglob("vrus"))
    (place / "999").mkdir()
    (place / "998").mkdir()
    (place / "998" / "track.json").symlink_to("nowhere")
    report, tracks = sequence(lambda content: None)
    assert report.rejected_by_reason["unreadable_file"] == 2
    assert report.totals()["tracks_read"] == tracks + 2


def test_signals_and_weather_of_any_kind_do_not_stop_a_conversion(sequence, tmp_path):
    context = next((tmp_path / "raw").glob("0000_*")) / "context"
    context.mkdir(exist_ok=True)
    kinds = [None, "x", [1], {"a": 1}, 1e400, 4, 10**30]
    stamp = 10**15
    lights = {f"ts_{stamp + i}": {"k1": kind, "f1": 4} for i, kind in enumerate(kinds)}
    (context / "traffic_light_signals.json").write_text(json.dumps({"status_data": lights}))
    (context / "weather_data.json").write_text(json.dumps({"weather_data": lights}))
    report, _ = sequence(lambda content: None)
    assert report.totals()["notes"].get("broken_context_files", 0) == 0


def test_no_name_of_a_track_leads_out_of_the_cache(vru_sample, tmp_path):
    raw = tmp_path / "raw"
    raw.mkdir()
    for folder in ("train", "eval", "test"):
        places = sorted(next(vru_sample.rglob(folder)).glob("*"))[:2]
        tracks = {place.name: json.loads((place / "track.json").read_text()) for place in places}
        name = next(iter(tracks))
        tracks["../../../outside"] = tracks[name]
        tracks["x" * 300] = tracks[name]
        (raw / f"{folder}_tracks.json").write_text(json.dumps(tracks))
    converted(ImptcVruDataset(raw), tmp_path / "a" / "b" / "cache")
    found = list(tmp_path.rglob("*outside*"))
    assert len(found) == 1  # the three overlap in time, and are one scene
    assert all(tmp_path / "a" / "b" / "cache" in path.parents for path in found)


def test_limits_decide_and_are_part_of_the_settings(tmp_path):
    folder = tmp_path / "raw" / "cyclists" / "moving"
    folder.mkdir(parents=True)
    (folder / "20.csv").write_text(RIDE)
    slow = RecordingLimits(speed_mps={"bicycle": 2.0}, slack_m=0.01)
    with pytest.raises(ConversionError, match="faster_than_its_mode': 1"):
        converted(ThabVruDataset(tmp_path / "raw", limits=slow), tmp_path / "cache")
    assert converted(ThabVruDataset(tmp_path / "raw"), tmp_path / "cache").totals()["scenes"] == 1


def test_a_grid_that_would_fill_the_memory_is_refused(tmp_path, thab_settings):
    settings = thab_settings()
    tiny = ConversionSettings(
        settings.dataset,
        tmp_path / "cache",
        type(settings.resample)(dt_s=1e-9),
        progress=False,
    )
    with pytest.raises(ConversionError, match="time_beyond_limit"):
        convert(tiny)


@pytest.mark.parametrize(
    "wrong", [{"span_s": 0.0}, {"speed_mps": {"horse": 3.0}}, {"speed_mps": {"car": -1.0}}]
)
def test_limits_are_checked_when_they_are_built(wrong):
    with pytest.raises(ConversionError, match="must"):
        RecordingLimits(**wrong)


def test_every_mode_has_a_limit():
    assert set(SPEED_MAX_MPS) == {mode.label for mode in Mode}


@pytest.mark.parametrize(
    ("first", "expected"),
    [
        ({"a": 0.0, "b": 5.0, "c": -900.0}, {"a", "b"}),
        ({"a": 0.0, "b": 900.0}, {"b"}),
        ({"a": 0.0}, {"a"}),
        ({}, set()),
    ],
)
def test_the_clock_of_most_tracks_is_taken(first, expected):
    last = {name: begin + 3.0 for name, begin in first.items()}
    assert on_one_clock(first, last, 10.0) == expected
