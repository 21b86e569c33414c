"""Conversion as a whole: resumable, parallel, all or nothing, and its errors."""

import dataclasses
import errno
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from trajdata.caching.df_cache import DataFrameCache

from data_converters import (
    CacheError,
    ConversionError,
    ConversionSettings,
    ImptcDataset,
    ImptcVruDataset,
    ResampleSettings,
    ThabVruDataset,
    TrackError,
    TwoWheelerDataset,
    ZeroPhaseSmoother,
    convert,
)
from dmmv_conventions.cache import read_state


def scene_bytes(folder):
    """Content of the tables and reports of the scenes of an environment.

    Equal pickles may differ in their bytes, hence in the hashes of the files.
    """
    tables = {path: path.read_bytes() for path in folder.glob("*/*.feather")}
    reports = {path: json.loads(path.read_text()) for path in folder.glob("*/*.json")}
    for report in reports.values():
        del report["files"]
    return {str(path.relative_to(folder)): held for path, held in (tables | reports).items()}


def count_scenes(monkeypatch):
    """Names of the scenes written from now on."""
    written = []
    original = DataFrameCache.save_agent_data

    def save(agent_data, cache_path, scene):
        written.append(scene.name)
        original(agent_data, cache_path, scene)

    monkeypatch.setattr(DataFrameCache, "save_agent_data", staticmethod(save))
    return written


def fail_after(monkeypatch, scenes, error):
    """Let the write of a scene fail with `error` after a number of scenes."""
    original = DataFrameCache.save_agent_data
    left = [scenes]

    def save(agent_data, cache_path, scene):
        if left[0] == 0:
            raise error
        left[0] -= 1
        original(agent_data, cache_path, scene)

    monkeypatch.setattr(DataFrameCache, "save_agent_data", staticmethod(save))


def test_every_track_is_either_converted_or_rejected_with_a_reason(thab_settings):
    report = convert(thab_settings())
    assert sum(report.agents()[split].get("bicycle", 0) for split in report.agents()) == 12
    assert report.rejected_by_reason == {"contained_in_another_file": 1, "repeated_timestamps": 1}
    assert report.totals()["tracks_read"] == 14


@pytest.mark.parametrize("folder", ["", "thab_vru"])
def test_the_report_stands_next_to_the_cache(thab_settings, folder):
    settings = thab_settings()
    report = convert(settings)
    stored = json.loads((settings.cache / folder / "conversion_report.json").read_text())
    assert stored["totals"]["rejected"] == report.rejected_by_reason
    assert stored["settings_hash"] == settings.digest()


def test_workers_change_nothing(thab_settings, tmp_path):
    serial = convert(thab_settings())
    parallel = convert(thab_settings(cache=tmp_path / "other", workers=2))
    assert serial.as_dict() == parallel.as_dict()
    one, two = (scene_bytes(tmp_path / c / "thab_vru") for c in ("cache", "other"))
    assert one == two


def test_an_interrupted_conversion_goes_on_where_it_stopped(thab_settings, monkeypatch):
    with monkeypatch.context() as patch:
        fail_after(patch, 5, KeyboardInterrupt())
        with pytest.raises(KeyboardInterrupt):
            convert(thab_settings())
    with pytest.raises(CacheError, match="interrupted conversion"):
        read_state(thab_settings().cache, "thab_vru", CacheError)
    written = count_scenes(monkeypatch)
    report = convert(thab_settings())
    assert len(written) == 12 - 5
    assert report.totals()["scenes"] == 12


KILLED = """
import sys, time
from pathlib import Path
from data_converters import ConversionSettings, ThabVruDataset, conversion, workers
def stay(settings, source):
    print("begun", flush=True)
    time.sleep(60)
workers.convert_scene = stay
root, cache = map(Path, sys.argv[1:])
conversion.convert(ConversionSettings(ThabVruDataset(root), cache, workers=2, progress=False))
"""


@pytest.mark.slow
def test_a_killed_conversion_leaves_no_worker_behind(thab, tmp_path):
    command = [sys.executable, "-c", KILLED, str(thab), str(tmp_path / "cache")]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as killed:
        assert killed.stdout is not None
        assert [killed.stdout.readline() for _ in range(2)] == 2 * [b"begun\n"]
        killed.kill()
        # until the last of those who write to it has ended
        killed.communicate(timeout=20)


def test_scenes_of_recordings_that_are_gone_do_not_stay(thab_settings, thab, monkeypatch):
    settings = thab_settings()
    with monkeypatch.context() as patch:
        fail_after(patch, 3, KeyboardInterrupt())
        with pytest.raises(KeyboardInterrupt):
            convert(settings)
    (first, *_) = settings.dataset.scenes()
    assert (settings.staging / first.name).is_dir()
    (thab / first.key).unlink()
    report = convert(thab_settings())
    left = {path.parent.name for path in (settings.cache / "thab_vru").glob("*/conversion.json")}
    assert left == {scene.name for scene in report.scenes}


def test_a_second_conversion_reuses_every_scene(thab_settings, monkeypatch):
    first = convert(thab_settings())
    written = count_scenes(monkeypatch)
    second = convert(thab_settings())
    assert written == []
    assert first.as_dict() == second.as_dict()


def test_only_changed_files_are_converted_again(thab_settings, thab, monkeypatch):
    convert(thab_settings())
    path = thab / "cyclists" / "moving" / "25.csv"
    path.write_text(path.read_text().rsplit("\n", 30)[0] + "\n")
    written = count_scenes(monkeypatch)
    convert(thab_settings())
    assert written == ["cyclists_moving_25"]


@pytest.mark.parametrize("earlier", [{"agents": {"vehicle": 1}}, {"sampling": {}}], ids=str)
def test_a_scene_that_tells_what_earlier_reports_did_is_converted_again(
    thab_settings, monkeypatch, earlier
):
    convert(thab_settings())
    path = thab_settings().cache / "thab_vru" / "cyclists_moving_25" / "conversion.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | earlier))
    written = count_scenes(monkeypatch)
    assert set(convert(thab_settings()).agents()["train"]) == {"bicycle"}
    assert written == ["cyclists_moving_25"]


def test_a_scene_in_which_two_agents_have_one_name_is_refused(thab_settings, monkeypatch):
    def read(dataset, scene, dt_s, *, strict):
        raw = original(dataset, scene, dt_s, strict=strict)
        raw.tracks *= 2
        return raw

    original = ThabVruDataset.read
    monkeypatch.setattr(ThabVruDataset, "read", read)
    with pytest.raises(ConversionError, match="`agents` must have a name each.*'track'"):
        convert(thab_settings())


DAMAGE = {
    "lost": lambda path: path.unlink(),
    "cut": lambda path: path.write_bytes(path.read_bytes()[:100]),
    "of another program": lambda path: path.write_bytes(b'{"name": "x", "colour": 1}'),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
@pytest.mark.parametrize(
    "file", ["agent_data*.feather", "scene_metadata*.dill", "scene_index*.pkl", "conversion.json"]
)
def test_a_scene_with_a_damaged_file_is_converted_again(thab_settings, monkeypatch, file, damage):
    convert(thab_settings())
    folder = thab_settings().cache / "thab_vru"
    path = next(folder.glob(f"cyclists_moving_25/{file}"))
    before = path.read_bytes()
    damage(path)
    (folder / "cyclists_moving_26" / "own.parquet").touch()
    written = count_scenes(monkeypatch)
    convert(thab_settings())
    assert written == ["cyclists_moving_25"]
    assert path.read_bytes() == before
    assert (folder / "cyclists_moving_26" / "own.parquet").exists()


def test_other_settings_convert_everything_again(thab_settings, monkeypatch):
    convert(thab_settings())
    written = count_scenes(monkeypatch)
    convert(thab_settings(resample=ResampleSettings(smoother=ZeroPhaseSmoother())))
    assert len(written) == 12
    assert read_state(thab_settings().cache, "thab_vru")["smoother"]["lookahead_s"] == 0.45


@pytest.mark.parametrize("workers", [1, 2])
def test_a_full_disk_gives_one_message_and_leaves_the_earlier_cache(
    thab_settings, monkeypatch, workers
):
    settings = thab_settings()
    convert(settings)
    before = scene_bytes(settings.cache / "thab_vru")
    fail_after(monkeypatch, 2, OSError(errno.ENOSPC, "No space left on device"))
    changed = thab_settings(resample=ResampleSettings(min_duration_s=2.0), workers=workers)
    with pytest.raises(ConversionError, match="free disk space.*run the same command again"):
        convert(changed)
    assert scene_bytes(settings.cache / "thab_vru") == before
    assert read_state(settings.cache, "thab_vru")["settings_hash"] == settings.digest()


@pytest.mark.parametrize("below", ["", "cache", "a/cache"])
def test_a_cache_where_no_folder_can_be_is_named(thab_settings, tmp_path, below):
    (tmp_path / "file").write_text("not a folder")
    settings = dataclasses.replace(thab_settings(), cache=tmp_path / "file" / below)
    told = "`cache` must be a folder that can be written, but got '.*file.* Give another one.$"
    with pytest.raises(ConversionError, match=told):
        convert(settings)


def test_a_cache_without_permission_is_named(thab_settings, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # a folder in the place of the lock: no user, the administrator neither, can open it
    (tmp_path / "cache" / ".lock_thab_vru").mkdir(parents=True)
    told = r"`cache` must be a folder that can be written, but got '.*\.lock_thab_vru' \(Is a dir"
    with pytest.raises(ConversionError, match=told):
        convert(thab_settings(cache=Path("cache")))


def test_another_failure_of_the_disk_is_not_called_full(thab_settings, monkeypatch):
    fail_after(monkeypatch, 2, OSError(errno.EIO, "Input/output error"))
    with pytest.raises(OSError, match="Input/output"):
        convert(thab_settings())


@pytest.fixture
def damaged(sample, tmp_path):
    """A copy of one sample sequence, and a function that edits its first VRU track."""
    folder = tmp_path / "raw" / next(sample.glob("0000_*")).name
    shutil.copytree(next(sample.glob("0000_*")), folder)
    path = folder / "vrus" / "000" / "track.json"

    def edit(change):
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))
        return ConversionSettings(
            ImptcDataset(tmp_path / "raw"), tmp_path / "cache", progress=False
        )

    return edit


def _without_timestamps(content):
    for row in content["track_data"].values():
        del row["ts"]


def _not_finite(content):
    next(iter(content["track_data"].values()))["coordinates"][0] = float("nan")


def _seconds(content):
    for row in content["track_data"].values():
        row["ts"] = int(row["ts"]) // 1_000_000


FAULTS = {
    "no_timestamps": _without_timestamps,
    "coordinates_not_finite": _not_finite,
    "unknown_timestamp_unit": _seconds,
    "unknown_class_id": lambda content: content["overview"].update(class_id=42),
    "missing_field": lambda content: content.pop("overview"),
}


@pytest.mark.parametrize(("reason", "change"), FAULTS.items())
def test_a_bad_track_is_counted_and_the_others_are_converted(damaged, reason, change):
    report = convert(damaged(change))
    assert report.rejected_by_reason == {reason: 1}
    assert report.scenes[0].rejected[0]["source"].endswith("vrus/000/track.json")
    assert report.totals()["scenes"] == 1


@pytest.mark.parametrize(("reason", "change"), FAULTS.items())
def test_strict_conversion_stops_at_a_bad_track_and_names_the_file(damaged, reason, change):
    settings = damaged(change)
    strict = ConversionSettings(settings.dataset, settings.cache, strict=True, progress=False)
    with pytest.raises(TrackError, match="track.json") as caught:
        convert(strict)
    assert caught.value.reason.value == reason
    assert not (settings.cache / "imptc").exists()


def test_a_track_file_cut_off_in_the_middle_is_rejected(damaged, tmp_path):
    settings = damaged(lambda content: None)
    path = next((tmp_path / "raw").glob("*/vrus/001/track.json"))
    path.write_text(path.read_text()[:500])
    assert convert(settings).rejected_by_reason == {"broken_json": 1}


def test_strict_conversion_stops_at_a_track_that_was_rejected_before(damaged):
    settings = damaged(_not_finite)
    convert(settings)
    with pytest.raises(TrackError, match="track.json"):
        convert(dataclasses.replace(settings, strict=True))


def test_strict_conversion_goes_on_where_tracks_are_left_out_on_purpose(thab_settings, thab):
    (thab / "cyclists" / "waiting" / "305.csv").unlink()  # without a clock
    assert convert(thab_settings()).rejected_by_reason == {"contained_in_another_file": 1}
    report = convert(thab_settings(strict=True))
    assert report.rejected_by_reason == {"contained_in_another_file": 1}


@pytest.mark.parametrize("family", ["vrus", "vehicles", "context"])
def test_any_folder_of_a_sequence_may_be_absent(damaged, tmp_path, family):
    settings = damaged(lambda content: None)
    shutil.rmtree(next((tmp_path / "raw").glob(f"*/{family}")))
    assert convert(settings).totals()["scenes"] == 1


def test_a_data_set_without_a_usable_track_fails(damaged, tmp_path):
    settings = damaged(_not_finite)
    for path in (tmp_path / "raw").glob("*/v*/*/track.json"):
        if path.parent.name != "000":
            path.unlink()
    says = "usable track.*coordinates_not_finite.*first fault: .*track.json.*conversion_report.json"
    with pytest.raises(ConversionError, match=says):
        convert(settings)
    stored = json.loads((settings.cache / "conversion_report.json").read_text())
    assert stored["totals"]["rejected"]["coordinates_not_finite"] == 1


@pytest.mark.parametrize(
    "dataset", [ImptcDataset, ImptcVruDataset, ThabVruDataset, TwoWheelerDataset]
)
def test_a_missing_data_set_is_named(dataset, tmp_path):
    with pytest.raises(ConversionError, match="`root` must hold .*nowhere"):
        convert(ConversionSettings(dataset(tmp_path / "nowhere"), tmp_path / "cache"))


@pytest.mark.parametrize("dataset", [ImptcDataset, ImptcVruDataset])
@pytest.mark.parametrize(
    ("leftover", "says"),
    [
        ("imptc_set_02.tar.gz.part", "finished download.*imptc_set_02.tar.gz.part"),
        (".unpacking_imptc_set_02", "finished download.*.unpacking_imptc_set_02"),
        ("imptc_set_01.tar.gz", "not unpacked.*imptc_set_01"),
    ],
)
def test_a_half_downloaded_or_packed_data_set_is_refused(tmp_path, dataset, leftover, says):
    (tmp_path / leftover).touch()
    with pytest.raises(ConversionError, match=says):
        convert(ConversionSettings(dataset(tmp_path), tmp_path / "cache"))


@pytest.mark.parametrize("workers", [0, -1])
def test_workers_must_be_positive(thab_settings, workers):
    with pytest.raises(ConversionError, match=f"`workers` must be at least 1, but got {workers}"):
        thab_settings(workers=workers)


def test_rows_of_an_agent_have_no_gap(converted):
    for path in converted.glob("imptc/*/agent_data_dt0.10.feather"):
        table = pd.read_feather(path)
        steps = table.groupby("agent_id")["scene_ts"].agg(["min", "max", "count"])
        assert np.all(steps["max"] - steps["min"] + 1 == steps["count"])
        assert np.isfinite(table.select_dtypes("number")).all().all()
