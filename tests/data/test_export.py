"""Exports: equal to what trajdata gives, whole or not at all, made once."""

import errno
import json
import pickle
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from torch.utils._pytree import tree_flatten

from diffstack_mmv.data import (
    ConvertedCache,
    DirectWindows,
    Export,
    ExportedWindows,
    ExportSettings,
    dataset,
    export_chunks,
    export_windows,
)
from diffstack_mmv.data import export as module


@pytest.fixture
def export(source, windows):
    return Export(source, "train", windows)


def same(first, second) -> bool:
    pairs = zip(tree_flatten(first)[0], tree_flatten(second)[0], strict=True)
    return all(torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b for a, b in pairs)


@pytest.mark.parametrize("workers", [0, 2])
def test_an_export_holds_the_samples_that_trajdata_gives(export, exporting, workers, monkeypatch):
    monkeypatch.setattr(export_chunks, "CHUNK", 10)
    settings = ExportSettings(exporting.folder, workers, progress=False)
    exported = ExportedWindows(export_windows(export, settings))
    direct = DirectWindows(export.source.open("train", export.windows), "toy")
    assert len(exported) == len(direct) > 20
    numbers = torch.randperm(len(direct)).tolist()
    assert same(exported[numbers], direct[numbers])
    assert exported.samples[direct.samples.columns].equals(direct.samples)


@pytest.mark.parametrize("workers", [0, 2])
def test_random_numbers_do_not_tell_whether_an_export_was_there(export, exporting, workers):
    numbers = []
    for _ in ("made", "found"):
        torch.manual_seed(0)
        export_windows(export, ExportSettings(exporting.folder, workers, progress=False))
        numbers.append(torch.rand(3))
    assert torch.equal(*numbers)


def test_an_export_is_made_once(export, exporting, monkeypatch):
    folder = export_windows(export, exporting)
    monkeypatch.setattr(module, "_write", lambda *_: pytest.fail("made again"))
    assert export_windows(export, exporting) == folder


@pytest.mark.parametrize(
    "change", [{"history_s": 3.0}, {"stride": 10}, {"neighbors": 8}, {"ego_modes": ("bicycle",)}]
)
def test_other_windows_make_another_export(export, exporting, change):
    other = export._replace(windows=replace(export.windows, **change))
    assert other.folder(exporting) != export.folder(exporting)


def test_an_interrupted_export_goes_on_where_it_stopped(export, exporting, monkeypatch):
    monkeypatch.setattr(export_chunks, "CHUNK", 10)
    write, written = export_chunks.ChunkWriter._write, []

    def failing(self, first, end):
        written.append(first)
        if len(written) == 3:
            raise KeyboardInterrupt
        write(self, first, end)

    monkeypatch.setattr(export_chunks.ChunkWriter, "_write", failing)
    with pytest.raises(KeyboardInterrupt):
        export_windows(export, exporting)
    exported = ExportedWindows(export_windows(export, exporting))
    assert written[:4] == [0, 10, 20, 20]
    assert len(written) == len(set(written)) + 1
    assert exported[range(len(exported))].ego_past.valid.all()


def test_a_full_disk_is_one_clear_error_and_leaves_no_export(export, exporting, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(export_chunks, "write_windows", full)
    with pytest.raises(OSError, match="`folder` must have free disk space.*Free space"):
        export_windows(export, exporting)
    assert not export.exists(exporting)


def test_a_window_with_nan_is_left_out_and_counted(export, exporting, monkeypatch):
    stack_batch = export_chunks.stack_batch

    def holed(*arguments):
        batch = stack_batch(*arguments)
        batch.ego_past.valid[0, 3] = False
        return batch

    monkeypatch.setattr(export_chunks, "stack_batch", holed)
    exported = ExportedWindows(export_windows(export, exporting))
    counts = exported.content["rows"]["bicycle"]
    assert counts["not_finite"] == 1
    assert exported.content["samples"] == exported.content["windows"] - 1 == len(exported)
    assert len(exported.samples) == len(exported)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda folder: (folder / "export.json").unlink(), "`export` must be complete"),
        (lambda folder: (folder / "export.json").write_text("{"), "must have a marker in JSON"),
        (
            lambda folder: (folder / "export.json").write_text(json.dumps({"version": 99})),
            "`version` must be 4, but got 99",
        ),
        (lambda folder: np.save(folder / "ego.npy", np.zeros(3)), "must have shape"),
        (
            lambda folder: np.save(folder / "ego.npy", np.load(folder / "ego.npy").astype("f8")),
            r"must have shape .* of float32, but got \(.*\) of float64",
        ),
        (lambda folder: (folder / "neighbors.npy").write_bytes(b""), "must be an array of shape"),
    ],
)
def test_a_damaged_or_foreign_export_names_the_file_and_the_remedy(
    export, exporting, change, complaint
):
    folder = export_windows(export, exporting)
    change(folder)
    with pytest.raises(ValueError, match=complaint) as error:
        ExportedWindows(folder)
    assert str(folder) in str(error.value)
    assert "Delete" in str(error.value)


def test_a_table_of_other_windows_is_refused(export, exporting):
    exported = ExportedWindows(export_windows(export, exporting))
    path = exported.folder / "samples.parquet"
    pd.read_parquet(path).iloc[1:].to_parquet(path)
    with pytest.raises(ValueError, match="`export` must have a row per window") as error:
        exported.samples  # noqa: B018
    assert str(path) in str(error.value)


def with_another_agent(folder):
    table = pd.read_parquet(folder / "samples.parquet")
    table.loc[len(table) - 1, "agent"] = "someone"
    table.to_parquet(folder / "samples.parquet")


def with_another_number(folder):
    ego = np.load(folder / "ego.npy")
    ego[-1].flat[0] += 1.0
    np.save(folder / "ego.npy", ego)


def test_the_digest_tells_any_change_of_the_samples_and_of_their_names(
    export, exporting, monkeypatch
):
    monkeypatch.setattr(dataset, "PIECE", 10)
    folder = export_windows(export, exporting)
    digests = [ExportedWindows(folder).digest()]
    assert ExportedWindows(folder).digest() == digests[0]
    assert len(ExportedWindows(folder)) > 20  # the last of them is in another piece
    for change in (with_another_agent, with_another_number):
        change(folder)
        digests.append(ExportedWindows(folder).digest())
    assert len(set(digests)) == 3


def test_a_pickled_export_holds_a_path_and_no_samples(export, exporting):
    exported = ExportedWindows(export_windows(export, exporting))
    content = pickle.dumps(exported)
    assert len(content) < 1000
    assert same(pickle.loads(content)[[3, 1]], exported[[3, 1]])


def test_batches_are_trimmed_to_their_own_largest_number_of_neighbors(export, exporting):
    exported = ExportedWindows(export_windows(export, exporting))
    alone = exported.samples.index[exported.samples["agent"] == "alone"].tolist()
    assert exported[alone].neighbors_past.valid.shape[1] == 0
    assert exported[[0, *alone]].neighbors_past.valid.shape[1] == 3


def test_samples_tell_the_recording_of_their_scene(cache, tmp_path, windows, exporting):
    shutil.copytree(cache, tmp_path / "cache")
    place = tmp_path / "cache" / "toy" / "cache.json"
    state = json.loads(place.read_text())
    for scene in state["scenes"][:2]:
        scene["recording"] = "ride"
    place.write_text(json.dumps(state))
    export = Export(ConvertedCache("toy", str(tmp_path / "cache")), "train", windows)
    folder = export_windows(export, exporting)
    samples = ExportedWindows(folder).samples
    told = dict(zip(samples["scene"], samples["recording"], strict=True))
    assert told == {f"scene_{n}": "ride" if n < 2 else f"scene_{n}" for n in range(5)}


def test_in_an_export_of_before_recordings_were_told_each_scene_is_one(export, exporting):
    folder = export_windows(export, exporting)
    digest = ExportedWindows(folder).digest()
    table = pd.read_parquet(folder / "samples.parquet")
    table.drop(columns="recording").to_parquet(folder / "samples.parquet", index=False)
    earlier = ExportedWindows(folder)
    assert earlier.samples["recording"].equals(earlier.samples["scene"])
    assert earlier.digest() == digest
