"""The data module on real recordings, which are not part of the project."""

import gzip

import numpy as np
import pandas as pd
import pytest
import torch

from data_converters import ConversionSettings, ThabVruDataset, convert
from diffstack_mmv.data import (
    ConvertedCache,
    ExportSettings,
    LoaderSettings,
    NamedDataset,
    TrajdataModule,
    WindowSettings,
    situations,
)

pytestmark = pytest.mark.slow

# trajdata's loader of SDD asks for every one of its videos
VIDEOS = {"bookstore": 7, "coupa": 4, "deathCircle": 5, "gates": 9}
VIDEOS |= {"hyang": 15, "little": 4, "nexus": 12, "quad": 4}
SCENE, VIDEO = "little", "video0"
EMPTY = '0 0 0 9 9 0 0 0 0 "Pedestrian"\n0 0 0 9 9 1 0 0 0 "Pedestrian"\n'
COLUMNS = ["id", "x0", "y0", "x1", "y1", "frame", "lost", "occluded", "generated", "label"]


def recordings(shared, *parts):
    folder = shared.joinpath("data", *parts)
    if not folder.exists():
        pytest.skip(f"needs the recordings {'/'.join(parts)} beside the project")
    return folder


def test_constant_velocity_on_cyclists_errs_as_the_recordings_are_known_to(shared, tmp_path):
    root = recordings(shared, "thab_vru")
    convert(ConversionSettings(ThabVruDataset(root), tmp_path, progress=False))
    module = TrajdataModule(
        ConvertedCache("thab_vru", str(tmp_path)),
        WindowSettings(ego_modes=("bicycle",)),
        LoaderSettings(),
        ExportSettings(str(tmp_path / "exports"), progress=False),
    )
    module.prepare_data()
    dataset = module.dataset("test")
    batch = dataset[range(len(dataset))]
    past, future = batch.ego_past.motion.position, batch.ego_future.motion.position
    velocity = (past[:, -1] - past[:, -6]) / 0.5
    predicted = velocity[:, None] * torch.arange(1, 31)[:, None] * 0.1
    error = (predicted - future).norm(dim=-1).mean(-1)
    moving = situations(batch).moving
    # as in the tables of docs/results/open_loop.md, causal smoother
    assert float(error.mean()) == pytest.approx(0.642, abs=2e-3)
    assert float(error[moving].mean()) == pytest.approx(0.955, abs=2e-3)
    assert int(moving.sum()) == 426


@pytest.fixture
def sdd(shared, tmp_path):
    """One video in trajdata's layout; the other videos hold next to nothing."""
    source = recordings(shared, "sdd", SCENE, VIDEO, "annotations.txt.gz")
    for scene, count in VIDEOS.items():
        for number in range(count):
            folder = tmp_path / "sdd" / scene / f"video{number}"
            folder.mkdir(parents=True)
            (folder / "annotations.txt").write_text(EMPTY)
    target = tmp_path / "sdd" / SCENE / VIDEO / "annotations.txt"
    target.write_bytes(gzip.decompress(source.read_bytes()))
    return tmp_path / "sdd"


@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_neighbors_are_where_the_annotations_of_the_crowd_put_them(sdd, shared, tmp_path):
    windows = WindowSettings(ego_modes=("bicycle",), stride=20)
    source = NamedDataset("sdd", str(sdd), str(tmp_path / "cache"))
    module = TrajdataModule(source, windows, LoaderSettings(), export=None)
    split = next(s for s in ("train", "val", "test") if SCENE in _scenes(source, s, windows))
    dataset = module.dataset(split)
    samples = dataset.samples
    chosen = samples.index[samples["scene"] == f"{SCENE}_{VIDEO[5:]}"][::10]
    raw = _positions(sdd / SCENE / VIDEO / "annotations.txt", shared)
    for number in chosen:
        batch, sample = dataset[[number]], samples.loc[number]
        now = raw.loc[sample["row"] * 3]
        ego = now.loc[int(sample["agent"])].to_numpy()
        distance = np.linalg.norm(now.to_numpy() - ego, axis=1)
        expected = np.sort(distance)[1 : 1 + batch.neighbors_past.mode.shape[1]]
        found = batch.neighbors_past.motion.position[0, :, -1].norm(dim=-1).numpy()
        np.testing.assert_allclose(found, expected, atol=0.3)
        if len(found) < windows.neighbors:
            beyond = np.sort(distance)[1 + len(found) :]
            assert (beyond > windows.radius_m - 0.3).all()
    assert len(chosen) > 5


def _scenes(source, split, windows):
    try:
        return {name.rsplit("_", 1)[0] for name in source.open(split, windows).locations().scene}
    except ValueError:
        return set()


def _positions(path, shared):
    """Box centres in m by frame and track, y downwards."""
    rows = pd.read_csv(path, sep=" ", header=None, names=COLUMNS)
    scales = pd.read_csv(shared / "data" / "sdd" / "scales.csv").set_index(["scene", "video"])
    scale = scales.loc[(SCENE, VIDEO), "metres_per_pixel"]
    rows["frame"] -= rows["frame"].min()
    rows["x"], rows["y"] = scale * (rows.x0 + rows.x1) / 2, scale * (rows.y0 + rows.y1) / 2
    return rows.set_index(["frame", "id"])[["x", "y"]].sort_index()
