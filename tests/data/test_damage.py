"""A damaged file of a cache is named in one line, whichever process meets it."""

import re

import pytest

from diffstack_mmv.data import (
    ConvertedCache,
    ExportSettings,
    LoaderSettings,
    TrajdataModule,
    export_chunks,
)
from dmmv_conventions.cache import conversion_of

from .conftest import crowd, write_cache


@pytest.fixture
def damaged(tmp_path, windows):
    """A cache in which a file is cut off, its path, and what loads it."""

    def cut(pattern, size, workers, export):
        cache = tmp_path / "cache"
        write_cache(cache, {"scene": ("train", crowd())})
        path = next(cache.glob(f"toy/scene/{pattern}"))
        path.write_bytes(path.read_bytes()[:size])
        loading = LoaderSettings(8, workers, 0)
        return path, TrajdataModule(ConvertedCache("toy", str(cache)), windows, loading, export)

    return cut


def told(path):
    """The message on a file of the cache, as a pattern."""
    remedy = re.escape(f" at {path}. {conversion_of('toy', path.parents[2])}")
    return rf"^`cache` must hold the files of its conversion, but got [^\n]*{remedy}$"


def first_batch(module):
    module.prepare_splits(["train"])
    return next(iter(module.evaluation_loader("train")))


@pytest.mark.parametrize("workers", [0, 1])
@pytest.mark.parametrize("exported", [True, False])
@pytest.mark.parametrize("pattern", ["agent_data*.feather", "scene_index*.pkl"])
def test_rows_that_are_cut_off_are_named(damaged, tmp_path, pattern, exported, workers):
    export = (
        ExportSettings(str(tmp_path / "exports"), workers, progress=False) if exported else None
    )
    path, module = damaged(pattern, 300, workers, export)
    with pytest.raises(ValueError, match=told(path)):
        first_batch(module)


@pytest.mark.parametrize("size", [0, 300])
def test_a_scene_that_is_cut_off_is_named(damaged, size):
    path, module = damaged("scene_metadata*.dill", size, 0, None)
    with pytest.raises(ValueError, match=told(path)):
        module.evaluation_loader("train")


def test_a_full_disk_is_told_by_a_worker_as_well(source, windows, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(export_chunks, "write_windows", full)
    export = ExportSettings(str(tmp_path), 1, progress=False)
    module = TrajdataModule(source, windows, LoaderSettings(8, 0, 0), export)
    with pytest.raises(OSError, match="^.Errno 28. `folder` must have free disk space.*Free space"):
        module.prepare_splits(["train"])


def test_a_mistake_of_ours_in_a_worker_keeps_its_traceback(source, windows, monkeypatch):
    def mistaken(*_):
        raise KeyError("mistake")

    module = TrajdataModule(source, windows, LoaderSettings(8, 1, 0), None)
    monkeypatch.setattr("diffstack_mmv.data.dataset.stack_batch", mistaken)
    with pytest.raises(KeyError, match="Original Traceback"):
        first_batch(module)
