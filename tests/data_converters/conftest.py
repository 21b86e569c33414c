"""Small sample recordings, a cache made of them, and a few builders of tracks and files."""

from pathlib import Path

import numpy as np
import pytest

from data_converters import (
    ConversionSettings,
    ImptcDataset,
    Mode,
    TableDataset,
    ThabVruDataset,
    convert,
    generate_sample,
    generate_vru_sample,
)
from data_converters.tracks import RawTrack
from tests.data_converters.synthetic import table

SEQUENCES = (0, 50, 200)


@pytest.fixture(scope="session")
def sample(tmp_path_factory) -> Path:
    """Three sample sequences of 18 s, one per split."""
    out = tmp_path_factory.mktemp("sample")
    generate_sample(out, seed=3, sequences=SEQUENCES, duration_s=18.0)
    return out


@pytest.fixture(scope="session")
def vru_sample(tmp_path_factory) -> Path:
    """The VRU release cut from the same sequences."""
    out = tmp_path_factory.mktemp("vru")
    generate_vru_sample(out, seed=3, sequences=SEQUENCES, duration_s=18.0)
    return out


@pytest.fixture(scope="session")
def converted(sample, tmp_path_factory) -> Path:
    """A cache of the sample sequences."""
    cache = tmp_path_factory.mktemp("cache")
    convert(ConversionSettings(ImptcDataset(sample), cache, progress=False))
    return cache


@pytest.fixture
def make_track():
    """Build a track from times (n,) s and functions of time."""

    def build(time_s, x, y=np.zeros_like, **options) -> RawTrack:
        position = np.column_stack([x(time_s), y(time_s), np.zeros_like(time_s)])
        return RawTrack(
            "agent", options.pop("mode", Mode.BICYCLE), time_s, position, "here", **options
        )

    return build


def _write_csv(path: Path, time_s, xy) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [
        f"{i},{t:.2f},{x:.2f},{y:.2f}" for i, (t, (x, y)) in enumerate(zip(time_s, xy, strict=True))
    ]
    path.write_text("\n".join([",timestamp,x,y", *rows]) + "\n")


@pytest.fixture
def thab(tmp_path):
    """TH-AB layout: 12 cyclists, a file cut out of one of them, a file without a clock."""
    root = tmp_path / "thab"
    time_s = np.arange(0.0, 12.0, 0.08)
    for number in range(12):
        rng = np.random.default_rng(number)
        xy = np.column_stack([3.0 * time_s, np.full_like(time_s, number)]) + rng.normal(
            0, 0.05, (150, 2)
        )
        _write_csv(root / "cyclists" / "moving" / f"{number + 20}.csv", time_s, xy)
        if number == 0:
            _write_csv(root / "cyclists" / "waiting" / "100020.csv", time_s[:50], xy[40:90])
    _write_csv(root / "cyclists" / "waiting" / "305.csv", 0.0 * time_s, rng.normal(size=(150, 2)))
    return root


@pytest.fixture
def thab_settings(thab, tmp_path):
    """Settings that convert the folder `thab`; keywords go to `ConversionSettings`."""

    def build(**options) -> ConversionSettings:
        options = {"progress": False, "cache": tmp_path / "cache", **options}
        return ConversionSettings(dataset=options.pop("dataset", ThabVruDataset(thab)), **options)

    return build


@pytest.fixture
def dataset(tmp_path):
    """A data set of tables, given by the stem of their files."""

    def build(*, tables=None, **options):
        for stem, content in (tables or {"day": table()}).items():
            path = tmp_path / f"{stem}.csv"
            path.parent.mkdir(parents=True, exist_ok=True)
            content.to_csv(path, index=False)
        return TableDataset(tmp_path, **options)

    return build
