"""Cases in recorded crowds: reproducible, across the flow, and passable."""

import numpy as np
import pytest
import torch

from diffstack_mmv.simulation import CrossingRules, PassageRules, RecordedCrossing
from diffstack_mmv.simulation.recorded.crossing import RecordedRows, rows_of
from diffstack_mmv.simulation.recorded.passage import Walks
from diffstack_mmv.types import map_tensors
from tests.simulation.recorded.conftest import Reader, recorded, stream

WAY_M = 14.0


def same(first, second):
    leaves = [torch.utils._pytree.tree_leaves(each) for each in (first, second)]
    pairs = [pair for pair in zip(*leaves, strict=True) if isinstance(pair[0], torch.Tensor)]
    return all(torch.equal(*pair) for pair in pairs)


def test_a_number_is_always_the_same_case(crossing):
    first = crossing().cases("test", [3, 1])
    assert same(first, crossing().cases("test", [3, 1]))
    assert same(map_tensors(lambda part: part[1], first), crossing().case("test", 1))
    assert not same(first, crossing().cases("train", [3, 1]))
    assert not same(crossing().case("test", 3), crossing().case("test", 1))


def test_the_way_crosses_the_flow_and_starts_free(crossing):
    scene = crossing(crossing=CrossingRules(turn_deg=0.0)).cases("test", range(6))
    crowd = scene.pedestrians
    assert torch.equal(scene.robot_goal, -scene.robot_position)
    assert torch.allclose(scene.robot_goal, torch.tensor([0.0, WAY_M / 2]).double())
    flow = crowd.track[..., 1:, :].diff(dim=-2)[crowd.inside[..., 2:]]
    assert flow[:, 0].abs().sum() > 3 * flow[:, 1].abs().sum()
    apart = (crowd.position - scene.robot_position[:, None]).norm(dim=-1) - crowd.radius
    assert (apart > 0.6).all()
    assert (crowd.radius <= 0.31).all()


def test_people_come_near_the_way(crossing):
    scene = crossing(met=4).cases("test", range(4))
    crowd = scene.pedestrians
    beyond = (crowd.track[..., 1].abs() - WAY_M / 2).clamp(min=0)
    apart = torch.where(crowd.inside, crowd.track[..., 0].hypot(beyond), torch.inf)
    assert ((apart[..., 8:32].amin(-1) < 2).sum(-1) >= 4).all()


def test_rows_between_two_recorded_ones_are_between_them():
    scene = recorded(torch.tensor([[[0.0, 0.0], [1.0, 0.0], [1.0, 2.0], [9.0, 9.0]]]).double())
    scene.tracks.valid[0, 3] = False
    rows = rows_of(scene, np.array([-0.05, 0.0, 0.05, 0.1, 0.15, 0.2, 0.25]))
    expected = [[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]
    assert np.allclose(rows.position[0, 1:6], expected)
    # nobody is there before the second known row, nor after the last one
    assert rows.inside[0].tolist() == [False, False, True, True, False, False, False]


def test_nobody_is_there_after_the_end_and_who_comes_later_is_left_out():
    scene = recorded(torch.arange(16.0).reshape(2, 4, 2).double() / 10)
    scene.tracks.valid[1, :3] = False
    rows = rows_of(scene, 0.1 * np.arange(6))
    assert rows.inside.tolist() == [[False, True, True, True, False, False], [False] * 6]
    assert len(rows_of(scene, 0.1 * np.arange(3)).position) == 1


def two_ways():
    """Two people who walk along x, to either side."""
    time = np.arange(30) * 0.25
    position = np.stack([np.stack([time * v, np.full(30, y)], -1) for v, y in ((1, 0), (-1, 1))])
    return RecordedRows(position, np.ones((2, 30), dtype=bool), np.full(2, 0.3))


@pytest.mark.parametrize("steps", [21, 22])
def test_a_place_may_be_busy_for_longer_than_an_episode_lasts(steps):
    until_end = CrossingRules(until_s=0.25 * steps).draw
    expected = until_end(two_ways(), 2, 0.25, np.random.RandomState(0))
    short = two_ways().later(0, 2 + steps)
    found = CrossingRules(until_s=6.0).draw(short, 2, 0.25, np.random.RandomState(0))
    assert found.heading == expected.heading
    assert np.array_equal(found.centre, expected.centre)


def test_the_way_is_drawn_on_both_sides_of_the_right_angle_to_the_flow():
    rows, random, rules = two_ways(), np.random.RandomState(0), CrossingRules(turn_deg=20.0)
    headings = [rules.draw(rows, 2, 0.25, random).heading for _ in range(60)]
    across = np.sin(headings)
    assert 0.3 < (across > 0).mean() < 0.7
    away = np.rad2deg(np.arcsin(np.cos(headings)) * np.sign(across))
    assert np.abs(away).max() < 20
    assert away.min() < -12
    assert away.max() > 12


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"from_s": -0.1}, "`from_s` must be at least 0"),
        ({"from_s": 3.0, "until_s": 3.0}, "`until_s - from_s` must be positive"),
        ({"turn_deg": -1.0}, "`turn_deg` must be at least 0"),
    ],
)
def test_a_place_that_is_never_busy_is_refused(given, told):
    assert CrossingRules(from_s=0.0, turn_deg=0.0).from_s == 0.0
    with pytest.raises(ValueError, match=told):
        CrossingRules(**given)


def walks(*positions, rows=60):
    place = np.tile(np.array(positions, dtype=float)[:, None], (1, rows, 1))
    inside = np.ones(place.shape[:2], dtype=bool)
    return Walks(place, inside, np.full(len(positions), 0.3), 0.25)


def test_nobody_is_in_the_way_of_who_is_alone():
    assert PassageRules().passable(walks((50.0, 50.0)), WAY_M, 0.3)


def test_a_wall_of_people_is_not_passable_until_it_opens():
    wall = walks(*[(x, 0.0) for x in np.arange(-8, 8, 0.5)])
    assert not PassageRules().passable(wall, WAY_M, 0.3)
    wall.inside[:, 30:] = False
    assert PassageRules().passable(wall, WAY_M, 0.3)


def test_somebody_in_the_middle_is_passed_by_a_bend():
    standing = walks((0.0, 0.0))
    assert PassageRules().passable(standing, WAY_M, 0.3)
    assert not PassageRules(bulges_m=(0.0,)).passable(standing, WAY_M, 0.3)


def test_a_straight_drive_hits_somebody(crossing):
    scene = crossing(blind_mps=1.0).cases("test", range(3))
    crowd, time = scene.pedestrians, 0.25 * torch.arange(33, dtype=torch.float64)
    way = torch.where(time < 0.5, time.square(), time - 0.25)
    robot = torch.stack((torch.zeros_like(way), way - WAY_M / 2), -1)
    apart = (crowd.track[:, :, 8:41] - robot).norm(dim=-1) - crowd.radius[..., None]
    hit = (apart < 0.3) & crowd.inside[:, :, 8:41]
    assert hit.flatten(1).any(-1).all()


def test_nobody_appears_beside_the_way(crossing):
    crowd = crossing(entry_m=4.0).cases("test", range(4)).pedestrians
    beyond = (crowd.track[..., 1].abs() - WAY_M / 2).clamp(min=0)
    apart = crowd.track[..., 0].hypot(beyond)
    entered = crowd.inside[..., 9:32] & ~crowd.inside[..., 8:31]
    assert (apart[..., 9:32][entered] >= 4).all()


@pytest.mark.parametrize(
    ("recording", "settings", "told"),
    [
        (stream(rows=60), {"history_s": 2.0}, "`least_s` must leave recordings of 8 s"),
        (recorded(torch.zeros(1, 200, 2).double()), {}, "`met` must leave a passable crossing"),
    ],
    ids=["too short", "too empty"],
)
def test_recordings_without_a_crossing_are_refused(recording, settings, told):
    with pytest.raises(ValueError, match=told):
        RecordedCrossing(Reader({"test": {"one": recording}}), **settings).case("test", 0)
