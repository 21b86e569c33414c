"""The cache as trajdata reads it, in forked workers too."""

import json
from collections import defaultdict

import numpy as np
import pandas as pd
import pytest
import torch
from torch.utils.data import DataLoader, Subset

from data_converters import CacheError, ConversionError, Mode, open_cache
from data_converters.imptc.modes import CLASS_MODES
from data_converters.imptc.sample.sensor import ACROSS_M, ALONG_M
from diffstack_mmv.data import ConvertedCache, read_tracks

WINDOW = {"history_sec": (4.0, 4.0), "future_sec": (3.0, 3.0)}


@pytest.fixture(scope="module")
def scooters(converted):
    """All scooters of all splits, neighbors within 30 m."""
    return open_cache(
        converted,
        {"imptc": ["train", "val", "test"]},
        only_predict=[Mode.SCOOTER],
        agent_interaction_distances=defaultdict(lambda: 30.0),
        max_neighbor_num=16,
        **WINDOW,
    )


def batches(dataset, workers, elements):
    context = "fork" if workers else None
    return DataLoader(
        Subset(dataset, elements),
        batch_size=32,
        num_workers=workers,
        collate_fn=dataset.get_collate_fn(),
        multiprocessing_context=context,
    )


def test_forked_workers_yield_the_same_batches_as_this_process(scooters):
    few = range(0, len(scooters), 12)
    for here, there in zip(batches(scooters, 0, few), batches(scooters, 2, few), strict=True):
        assert torch.equal(here.agent_hist, there.agent_hist)
        assert torch.equal(here.neigh_types, there.neigh_types)
        assert here.agent_name == there.agent_name


def test_the_mode_of_ego_and_neighbors_survives_into_the_batch(scooters):
    seen = set()
    for batch in batches(scooters, 0, range(0, len(scooters), 12)):
        assert torch.unique(batch.agent_type).tolist() == [Mode.SCOOTER]
        seen |= set(torch.unique(batch.neigh_types).int().tolist())
    assert {Mode.BICYCLE, Mode.MOTORCYCLE, Mode.PEDESTRIAN, Mode.CAR} <= seen


def test_a_window_has_four_seconds_of_history_and_three_of_future(scooters):
    batch = next(iter(batches(scooters, 0, range(0, 64, 2))))
    assert batch.agent_hist.shape[1:] == (41, 8)
    assert batch.agent_fut.shape[1:] == (30, 8)
    assert torch.isfinite(batch.agent_hist).all()
    assert batch.dt.unique().tolist() == pytest.approx([0.1])


def test_extents_are_those_of_the_mode_or_of_the_cuboid(scooters):
    batch = next(iter(batches(scooters, 0, range(0, 64, 2))))
    assert batch.agent_hist_extent[0, 0].tolist() == pytest.approx([1.2, 0.6, 1.85])
    cars = batch.neigh_hist_extents[batch.neigh_types == Mode.CAR][:, -1, 0]
    assert len(torch.unique(cars)) > 1
    assert ((cars > 3.5) & (cars < 5.5)).all()


@pytest.mark.parametrize("mode", ["car", "bicycle", "scooter", "motorcycle", "pedestrian"])
def test_every_track_is_found_under_the_mode_that_the_report_counts_it_under(converted, mode):
    splits = ("train", "val", "test")
    agents = json.loads((converted / "conversion_report.json").read_text())["totals"]["agents"]
    tracks = read_tracks(ConvertedCache("imptc", str(converted)), splits, mode)
    assert len(tracks) == sum(agents[split][mode] for split in splits) > 0


def test_positions_in_the_cache_are_the_recorded_ones_within_the_noise(sample, converted):
    dataset = open_cache(converted, {"imptc": ["train", "val", "test"]}, **WINDOW)
    for scene in dataset.scenes():
        origin, recorded = read_raw(sample / scene.name)
        rows = pd.read_feather(converted / "imptc" / scene.name / "agent_data_dt0.10.feather")
        for agent in scene.agents:
            class_id, stamps, raw = recorded[agent.name.removesuffix("_s1")]
            assert agent.type is CLASS_MODES[class_id]
            mine = rows[rows["agent_id"] == agent.name]
            steps = mine["scene_ts"].to_numpy()
            assert (steps[0], steps[-1]) == (agent.first_timestep, agent.last_timestep)
            at_us = origin + steps * 100_000
            expected = np.column_stack([np.interp(at_us, stamps, raw[:, i]) for i in range(2)])
            error = expected - mine[["x", "y"]].to_numpy()
            assert np.abs(error.mean(axis=0)).max() < 0.03
            assert np.sqrt((error**2).sum(axis=1).mean()) < 1.1 * np.hypot(ALONG_M, ACROSS_M)


def read_raw(folder):
    """First timestamp of a sequence; class, timestamps and coordinates of its tracks by name."""
    recorded = {}
    for path in folder.glob("v*/*/track.json"):
        content = json.loads(path.read_text())
        rows = content["track_data"].values()
        recorded[f"{path.parts[-3][:-1]}_{path.parts[-2]}"] = (
            content["overview"]["class_id"],
            np.array([int(row["ts"]) for row in rows]),
            np.array([row["coordinates"] for row in rows]),
        )
    return min(stamps[0] for _, stamps, _ in recorded.values()), recorded


@pytest.mark.parametrize(
    "splits", [{"imptc": ["training"]}, {"imptc": []}, {"imptc": ["train", "all"]}]
)
def test_an_unknown_split_is_refused(converted, splits):
    with pytest.raises(ConversionError, match="splits"):
        open_cache(converted, splits)


def test_a_data_set_that_was_not_converted_is_named(converted):
    with pytest.raises(CacheError, match="imptc_vru.*no such file.*convert.py"):
        open_cache(converted, {"imptc_vru": ["train"]})
