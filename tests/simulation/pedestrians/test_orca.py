"""Crowds against every recorded trajectory, and properties that need no recording."""

import numpy as np
import pytest
import torch

from diffstack_mmv.simulation import CircleCrossing, OrcaCrowd
from diffstack_mmv.simulation.pedestrians import CrowdState, VisibleRobot, orca, orca_library

RECORDINGS = [
    f"{scenario}_crossing_{size}"
    for scenario in ("circle", "square")
    for size in (
        "h5_dt025_cases000-099",
        "h5_dt010_cases000-099",
        "h10_dt025_cases000-049",
        "h20_dt025_cases000-049",
    )
] + ["circle_crossing_h20_r6_dt025_cases000-049"]


@pytest.fixture
def in_tensors(monkeypatch):
    """Without the library."""
    monkeypatch.setattr(orca, "is_possible", lambda *_, **__: False)
    for used in ("roll", "respond"):
        monkeypatch.setattr(orca, used, lambda *_: pytest.fail("there is no library"))


@pytest.fixture
def crowd():
    return CircleCrossing(humans=6).cases("test", range(4)).pedestrians


def follow(recorded, steps):
    """Run the crowd of a recording and compare every step."""
    columns = ("start", "goals", "radii", "v_pref")
    start, goal, radius, speed = (torch.from_numpy(recorded[column]) for column in columns)
    crowd, dt_s = (
        CrowdState(start, torch.zeros_like(start), goal, radius, speed),
        float(recorded["dt"]),
    )
    for step in range(1, steps + 1):
        crowd = crowd.moved(OrcaCrowd()(crowd, dt_s), dt_s)
        assert np.array_equal(crowd.velocity.numpy(), recorded["velocities"][:, step])
        assert np.array_equal(crowd.position.numpy(), recorded["positions"][:, step])


@pytest.mark.parametrize(
    ("name", "steps"),
    [
        ("circle_crossing_h5_dt025_cases000-099", 100),
        ("square_crossing_h5_dt010_cases000-099", 60),
        ("square_crossing_h10_dt025_cases000-049", 40),
        ("circle_crossing_h20_dt025_cases000-049", 20),
    ],
)
def test_trajectories_are_reproduced_bit_for_bit(recording, name, steps):
    follow(recording(name), steps)


@pytest.mark.usefixtures("in_tensors")
def test_tensors_reproduce_them_as_well(recording):
    follow(recording("square_crossing_h10_dt025_cases000-049"), 30)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("most", [2, 30])
def test_library_and_tensors_agree_bit_by_bit(monkeypatch, dtype, most):
    """In a throng with somebody at the place of another, where no course is free."""
    draw = torch.Generator().manual_seed(3)
    crowd = CircleCrossing(humans=9).cases("test", range(8)).pedestrians
    crowd = CrowdState(*(field.to(dtype) for field in crowd))
    velocity = 0.5 * torch.randn(8, 9, 2, generator=draw, dtype=dtype)
    place = 0.3 * crowd.position
    place[:, 1] = place[:, 0]
    crowd = crowd._replace(position=place, velocity=velocity)
    goals = 4 * torch.randn(8, 9, 5, 2, generator=draw, dtype=dtype)
    robot = VisibleRobot(goals[:, 0, 0], velocity[:, 0], crowd.radius[:, 0])
    model = OrcaCrowd(max_neighbors=most)

    def answers():
        steps = model.positions(crowd, 0.25, 12)
        return (
            model(crowd, 0.25),
            model(crowd, 0.25, robot),
            model.responses(crowd, goals, 1),
            steps,
        )

    assert orca_library.is_possible(crowd)
    found = answers()
    for used in ("roll", "respond"):
        monkeypatch.setattr(orca, used, lambda *_: pytest.fail("there is no library"))
    monkeypatch.setattr(orca, "is_possible", lambda *_, **__: False)
    for here, there in zip(found, answers(), strict=True):
        assert torch.equal(here.nan_to_num(7.0), there.nan_to_num(7.0))


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDINGS)
def test_every_trajectory_is_reproduced_bit_for_bit_to_its_end(recording, name):
    recorded = recording(name)
    follow(recorded, recorded["positions"].shape[1] - 1)


def test_a_batch_of_episodes_equals_its_episodes_one_by_one(crowd):
    together = OrcaCrowd()(crowd, 0.25)
    alone = [OrcaCrowd()(CrowdState(*(f[episode] for f in crowd)), 0.25) for episode in range(4)]
    assert torch.equal(together, torch.stack(alone))


def test_the_response_to_the_own_goal_is_what_the_human_does(crowd):
    goals = torch.stack((crowd.goal, -crowd.goal, crowd.position), dim=-2)
    responses = OrcaCrowd().responses(crowd, goals, 0.25)
    assert torch.equal(responses[..., 0, :], OrcaCrowd()(crowd, 0.25))
    other = OrcaCrowd()(crowd._replace(goal=-crowd.goal), 0.25)
    assert torch.equal(responses[..., 1, :], other)


def test_any_leading_dimensions_are_taken(crowd):
    folded = CrowdState(*(field.unflatten(0, (2, 2)) for field in crowd))
    assert torch.equal(OrcaCrowd()(folded, 0.25).flatten(0, 1), OrcaCrowd()(crowd, 0.25))


def test_a_human_alone_walks_straight_to_its_goal():
    crowd = CircleCrossing(humans=1).case("test", 3).pedestrians
    velocity = OrcaCrowd()(crowd, 0.25)
    way = crowd.goal - crowd.position
    assert torch.allclose(velocity, way / way.norm(dim=-1, keepdim=True), atol=1e-6)


@pytest.mark.parametrize(("away_m", "matters"), [(0.7, True), (50.0, False)])
def test_pedestrians_give_way_to_a_robot_nearby(crowd, away_m, matters):
    place = crowd.position[:, 0] + away_m
    robot = VisibleRobot(place, torch.zeros_like(place), torch.full((4,), 0.3, dtype=torch.float64))
    alone = OrcaCrowd()(crowd, 0.25)
    assert torch.equal(OrcaCrowd()(crowd, 0.25, robot), alone) != matters


@pytest.mark.parametrize(("most", "matters"), [(1, False), (2, True)])
def test_only_as_many_neighbors_as_asked_for_are_avoided(most, matters) -> None:
    place = torch.tensor([[0.0, 0.0], [0.8, 0.3], [0.9, -0.4]], dtype=torch.float64)
    still, ones = torch.zeros_like(place), torch.ones(3, dtype=torch.float64)
    crowd = CrowdState(place, still, place + torch.tensor([4.0, 0.0]), 0.3 * ones, ones)
    away = crowd._replace(position=place + torch.tensor([[0.0], [0.0], [1.0]]))
    both = [OrcaCrowd(max_neighbors=most)(each, 0.25)[0] for each in (crowd, away)]
    assert torch.equal(*both) is not matters


def test_where_nobody_is_nobody_moves():
    crowd = CircleCrossing(humans=0).cases("test", range(2)).pedestrians
    assert OrcaCrowd()(crowd, 0.25).shape == (2, 0, 2)
    assert OrcaCrowd().positions(crowd, 0.25, 3).shape == (2, 0, 3, 2)
    assert OrcaCrowd().responses(crowd, torch.zeros(2, 0, 4, 2), 0.25).shape == (2, 0, 4, 2)


def test_nobody_is_faster_than_preferred(crowd):
    for _ in range(30):
        crowd = crowd.moved(OrcaCrowd()(crowd, 0.25), 0.25)
        assert (crowd.velocity.norm(dim=-1) <= 1 + 1e-6).all()


def test_pedestrians_keep_clear_of_each_other(crowd):
    apart = torch.eye(6) * 9
    for _ in range(40):
        crowd = crowd.moved(OrcaCrowd()(crowd, 0.25), 0.25)
        assert (torch.cdist(crowd.position, crowd.position) + apart > 0.6).all()


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("neighbor_distance_m", 0.0),
        ("max_neighbors", 0),
        ("time_horizon_s", -1.0),
        ("margin_m", -1.0),
    ],
)
def test_impossible_settings_are_refused_by_name(setting, value):
    with pytest.raises(ValueError, match=f"`{setting}` must"):
        OrcaCrowd(**{setting: value})


@pytest.mark.parametrize(
    "change",
    [
        lambda crowd, robot: (crowd, VisibleRobot(*(each[:1] for each in robot))),
        lambda crowd, robot: (crowd, VisibleRobot(*(each[0] for each in robot))),
        lambda crowd, robot: (crowd._replace(goal=crowd.goal[:1]), robot),
    ],
)
def test_what_all_episodes_share_counts_for_each(crowd, change):
    """The library takes one number after the other, and read beyond those that are shared."""
    crowd = crowd._replace(goal=crowd.goal[:1].expand_as(crowd.goal))
    place = crowd.position.new_zeros(4, 2)
    robot = VisibleRobot(place, place, place[:, 0] + 0.3)
    assert orca_library.is_possible(crowd, robot)
    expected = OrcaCrowd()(crowd, 0.25, robot)
    narrow, seen = change(crowd, robot)
    assert torch.equal(OrcaCrowd()(narrow, 0.25, seen), expected)


def test_goals_of_other_crowds_are_not_read(crowd):
    """One more dimension than the crowd: the library wrote beyond what there was room for."""
    one = CrowdState(*(each[0] for each in crowd))
    goals = crowd.goal.unsqueeze(-2).expand(4, 6, 3, 2)
    assert not orca_library.is_possible(one, goals=goals)
    expected = torch.stack([OrcaCrowd().responses(one, each, 0.25) for each in goals])
    assert torch.equal(OrcaCrowd().responses(one, goals, 0.25), expected)
