"""Windows read from trajdata: who is in them, and where."""

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from diffstack_mmv.data import ConvertedCache, WindowSettings, stack_batch
from diffstack_mmv.geometry import position_in_frame
from diffstack_mmv.types import Mode

from .conftest import ToyAgent, crowd, write_cache


@pytest.fixture
def opened(source, windows):
    return source.open("train", windows)


def test_only_agents_of_the_ego_modes_become_egos(opened):
    assert set(opened.locations().agent) == {"cyclist", "rider", "alone"}
    assert set(opened.locations().mode.tolist()) == {Mode.BICYCLE, Mode.SCOOTER}


def test_locations_name_the_elements_they_point_at(opened):
    where = opened.locations()
    elements = [opened[int(number)] for number in where.element]
    assert [e.agent_name for e in elements] == where.agent
    assert [e.scene_id for e in elements] == where.scene
    assert [e.scene_ts for e in elements] == where.row.tolist()


@pytest.mark.parametrize("stride", [1, 5, 7])
def test_windows_of_an_agent_are_one_stride_apart(source, stride):
    where = source.open("train", WindowSettings(stride=stride)).locations()
    rows = where.row[[agent == "cyclist" for agent in where.agent]][:3]
    assert rows.tolist() == [40, 40 + stride, 40 + 2 * stride]


def test_scooters_keep_their_mode_as_ego_and_as_neighbor_through_forked_workers(opened, windows):
    loader = DataLoader(
        opened,
        batch_size=16,
        num_workers=2,
        collate_fn=opened.get_collate_fn(),
        multiprocessing_context="fork",
    )
    batches = [stack_batch(batch, windows) for batch in loader]
    ego = torch.cat([batch.ego_past.mode for batch in batches])
    neighbors = torch.cat([batch.neighbors_past.mode.flatten() for batch in batches])
    assert set(ego.tolist()) == {Mode.BICYCLE, Mode.SCOOTER}
    present = {Mode.BICYCLE, Mode.SCOOTER, Mode.PEDESTRIAN, Mode.WHEELCHAIR}
    assert present <= set(neighbors.tolist()) <= {*present, Mode.UNKNOWN}


def test_neighbors_stand_where_the_world_has_them_seen_from_the_ego(opened, windows):
    where = opened.locations()
    number = next(i for i, agent in enumerate(where.agent) if agent == "cyclist")
    batch = stack_batch(opened.get_collate_fn()([opened[int(where.element[number])]]), windows)
    tables = {
        a.name: torch.tensor(a.table().to_numpy()[:, [0, 1, 7]].astype(float)) for a in crowd()
    }
    ego = tables["cyclist"][40]
    for place, mode in enumerate(batch.neighbors_past.mode[0].tolist()):
        name = {5: "rider", 2: "walker", 9: "waiting"}[mode]
        world = tables[name][40 - next(a.first for a in crowd() if a.name == name)]
        expected = position_in_frame(world[None, :2], ego[:2], ego[2])[0]
        found = batch.neighbors_past.motion.position[0, place, -1]
        torch.testing.assert_close(found, expected.float(), atol=1e-4, rtol=0)


@pytest.mark.parametrize(
    ("limits", "count"),
    [
        ({"neighbors": 2}, 2),
        ({"neighbors": 1}, 1),
        ({"neighbors": 16}, 3),
        ({"radius_m": 100.0}, 4),
    ],
)
def test_neighbors_are_sorted_by_distance_and_cut_at_the_radius_and_number(source, limits, count):
    settings = WindowSettings(ego_modes=("bicycle",), **limits)
    opened = source.open("val", settings)
    batch = stack_batch(opened.get_collate_fn()([opened[0]]), settings)
    distance = batch.neighbors_past.motion.position[0, :, -1].norm(dim=-1)
    assert distance.shape == (count,)
    assert (distance.diff() >= 0).all()


def test_a_neighbor_that_ends_now_has_no_future(opened, windows):
    where = opened.locations()
    rows = [where.agent[i] == "cyclist" and where.row[i] == 45 for i in range(len(where.row))]
    element = opened[int(where.element[rows.index(True)])]
    batch = stack_batch(opened.get_collate_fn()([element]), windows)
    walker = (batch.neighbors_past.mode[0] == Mode.PEDESTRIAN).nonzero().item()
    assert batch.neighbors_past.valid[0, walker].sum() == 30
    assert not batch.neighbors_future.valid[0, walker].any()


def test_a_split_without_a_window_is_refused_with_the_counts(source):
    told = r"at least one window of 71 rows, but got none for stroller \(no row\); other modes: \w+"
    with pytest.raises(ValueError, match=told):
        source.open("val", WindowSettings(ego_modes=("stroller",)))


# no float divided by 0.1 is 3
@pytest.mark.parametrize(
    ("dt_s", "rows"), [(0.1, 41), (0.2, 21), (0.5, 9), (0.3, 8), (0.6, 4), (0.7, 4)]
)
def test_the_step_may_be_a_multiple_of_the_recorded_one(tmp_path, dt_s, rows):
    agent = ToyAgent("cyclist", Mode.BICYCLE, 90, yaw_rate=0.3)
    write_cache(tmp_path, {"only": ("train", [agent])})
    seconds = {"history_s": round((rows - 1) * dt_s, 3), "horizon_s": round(3 * dt_s, 3)}
    settings = WindowSettings(dt_s=dt_s, **seconds)
    opened = ConvertedCache("toy", str(tmp_path)).open("train", settings)
    batch = stack_batch(opened.get_collate_fn()([opened[0]]), settings)
    assert batch.ego_past.motion.position.shape == (1, rows, 2)
    np.testing.assert_allclose(batch.ego_past.motion.yaw_rate, 0.3, atol=1e-4)


def test_paths_and_agents_may_have_any_letters(tmp_path):
    folder = tmp_path / "a folder für Läufe"
    agents = [ToyAgent("fußgänger", Mode.BICYCLE, 90)]
    write_cache(folder, {"kreuzung_ä": ("train", agents)})
    opened = ConvertedCache("toy", str(folder)).open("train", WindowSettings())
    assert set(opened.locations().agent) == {"fußgänger"}
    assert set(opened.locations().scene) == {"kreuzung_ä"}
    assert opened[0].agent_name == "fußgänger"
    assert opened.get_scene(0).name == "kreuzung_ä"
