"""Samples per second of the data module: from an export, and straight from trajdata."""

from pathlib import Path

import pytest
from trajdata import UnifiedDataset

from diffstack_mmv.data import (
    ConvertedCache,
    DirectWindows,
    Export,
    ExportedWindows,
    ExportSettings,
    LoaderSettings,
    Splits,
    TrajdataModule,
    WindowSettings,
    export_windows,
)
from tests.data.conftest import crowd, write_cache

BATCH = 64
WINDOWS = WindowSettings(ego_modes=("bicycle", "scooter"), stride=1)


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> ConvertedCache:
    """Twelve scenes of five agents, two of which are egos."""
    folder = tmp_path_factory.mktemp("cache")
    write_cache(folder, {f"scene_{number}": ("train", crowd()) for number in range(12)})
    return ConvertedCache("toy", str(folder))


@pytest.fixture(scope="module")
def exporting(tmp_path_factory) -> ExportSettings:
    return ExportSettings(str(tmp_path_factory.mktemp("exports")), progress=False)


def per_second(benchmark, samples):
    benchmark.extra_info["samples_per_s"] = round(samples / benchmark.stats["median"])


def test_batches_from_an_export(benchmark, source, exporting):
    exported = ExportedWindows(export_windows(Export(source, "train", WINDOWS), exporting))
    numbers = list(range(0, 4 * BATCH, 4))
    benchmark(lambda: exported[numbers])
    per_second(benchmark, BATCH)


@pytest.mark.parametrize("workers", [0, 1, 2])
def test_an_epoch_of_the_data_module(benchmark, source, exporting, workers):
    loading, splits = LoaderSettings(BATCH, workers), Splits("train", "train", "train")
    module = TrajdataModule(source, WINDOWS, loading, exporting, splits)
    module.prepare_data()
    loader = module.train_dataloader()
    count = len(module.dataset("train"))

    def epochs():
        for epoch in range(20):
            loader.sampler.set_epoch(epoch)
            for _ in loader:
                pass

    benchmark.pedantic(epochs, rounds=3, warmup_rounds=1)
    per_second(benchmark, 20 * count)


def test_samples_straight_from_trajdata_with_the_scene_kept_open(benchmark, source):
    direct = DirectWindows(source.open("train", WINDOWS), "toy")
    numbers = list(range(BATCH))
    benchmark.pedantic(lambda: direct[numbers], rounds=5, warmup_rounds=1)
    per_second(benchmark, BATCH)


def test_samples_as_trajdata_alone_reads_them(benchmark, source):
    opened = source.open("train", WINDOWS)

    def read():
        for number in range(BATCH):
            UnifiedDataset.__getitem__(opened, number)

    benchmark.pedantic(read, rounds=3, warmup_rounds=1)
    per_second(benchmark, BATCH)


def test_an_export(benchmark, source, tmp_path):
    export, folders = Export(source, "train", WINDOWS), iter(range(99))

    def write() -> Path:
        return export_windows(export, ExportSettings(str(tmp_path / str(next(folders))), 0, False))

    folder = benchmark.pedantic(write, rounds=3)
    per_second(benchmark, len(ExportedWindows(folder)))
