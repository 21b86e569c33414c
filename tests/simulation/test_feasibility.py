"""Collisions that nobody could have avoided are told from those that somebody could."""

from dataclasses import replace

import pytest
import torch

from diffstack_mmv.simulation import (
    AvoidanceSearch,
    HolonomicRobot,
    OrcaCrowd,
    SquareCrossing,
    StraightLine,
    WanderingCrossing,
    World,
    drive,
)
from diffstack_mmv.simulation.pedestrians import CrowdState
from diffstack_mmv.simulation.verdicts import ExactVerdict
from diffstack_mmv.types import Outcome
from dmmv_conventions.progress import shown_by
from tests.heard import Heard

SCENARIO = SquareCrossing()


def world_with(speed_mps):
    return World(HolonomicRobot(speed_mps), OrcaCrowd(), ExactVerdict(10.0))


@pytest.fixture(scope="module")
def collided():
    """The cases among the first of the training phase in which driving straight collides."""
    numbers = list(range(12))
    with shown_by(heard := Heard()):
        record = drive(world_with(1.0), SCENARIO.cases("train", numbers), StraightLine()).record
    assert "drive: step 1" in heard.titles
    rows = (record.outcome == Outcome.COLLISION).nonzero().flatten().tolist()
    return [
        {"case": numbers[row], "outcome": "collision", "time_s": float(record.duration[row])}
        for row in rows
    ]


def test_collisions_of_somebody_who_could_go_elsewhere_are_avoidable(collided):
    assert collided
    cases = [dict(case) for case in collided] + [{"case": 99, "outcome": "success", "time_s": 9.0}]
    with shown_by(heard := Heard()):
        told = AvoidanceSearch(64).judge(world_with(1.0), SCENARIO, "train", cases)
    assert heard.titles == [
        f"search avoidable collisions: case {number}" for number in range(1, len(cases))
    ]
    assert all(0 < case["avoidable"] <= 1 for case in cases[:-1])
    assert "avoidable" not in cases[-1]
    assert told["n"] == len(cases)
    assert told["collision_rate"] == pytest.approx(len(collided) / len(cases))
    assert told["success_rate"] == pytest.approx(1 / len(cases))


def test_who_cannot_move_out_of_the_way_could_not_avoid_anything(collided):
    cases = [dict(case, time_s=9.0) for case in collided]
    search = AvoidanceSearch(8)
    shares = [search(world_with(1e-6), SCENARIO.cases("train", [n]), 9.5) for n in range(12)]
    assert min(shares) == 0.0
    assert set(shares) <= {0.0, 1.0}
    told = search.judge(world_with(1e-6), SCENARIO, "train", cases)
    assert told["n"] == sum(case["avoidable"] > 0 for case in cases)
    caught = [case for case in cases if case["avoidable"] == 0]
    told = search.judge(world_with(1e-6), SCENARIO, "train", caught)
    assert told == {"n": 0, "success_rate": None, "collision_rate": None}


class Closing:
    """People who close a ring around the start at a constant pace."""

    def __call__(self, crowd, dt_s, robot=None):
        return -0.375 * (crowd.position / crowd.position.norm(dim=-1, keepdim=True))


@pytest.mark.parametrize(("ahead_m", "avoidable"), [(0.5, True), (6.0, False)])
def test_whoever_arrives_before_it_becomes_narrow_has_avoided_it(ahead_m, avoidable):
    angle = torch.arange(24).double() * (torch.pi / 12)
    ring = 1.2 * torch.stack([angle.cos(), angle.sin()], -1)
    scene, one = SCENARIO.cases("train", [0]), torch.ones(1, 24).double()
    crowd = CrowdState(ring[None], 0 * ring[None], ring[None], 0.3 * one, one)
    scene = scene._replace(
        robot_position=torch.zeros(1, 2).double(),
        robot_goal=torch.tensor([[ahead_m, 0.0]]).double(),
        pedestrians=crowd,
    )
    world = replace(world_with(1.0), crowd=Closing())
    assert (AvoidanceSearch(256)(world, scene, 3.0) > 0) == avoidable


def test_the_search_is_the_same_every_time(collided):
    scene = SCENARIO.cases("train", [collided[0]["case"]])
    first, second = (AvoidanceSearch(32)(world_with(1.0), scene, 3.0) for _ in range(2))
    assert first == second


class Unaware:
    """A crowd that does not care for the robot it is shown, and notes how many it is shown."""

    def __init__(self):
        self.robots = []

    def __call__(self, crowd, dt_s, robot=None):
        self.robots.append(len(crowd.position))
        return OrcaCrowd()(crowd, dt_s)


def test_walks_told_beforehand_are_those_walked_beside_every_sequence():
    wandering = WanderingCrossing(humans=6, circle_radius_m=3.0, arena_m=4.0, change_every_s=1.0)
    scene = replace(wandering, change_chance=0.5).cases("train", [3])
    world = world_with(1.0)
    beside = replace(world, crowd=(unaware := Unaware()), robot_visible=True)
    told, walked = (AvoidanceSearch(32)(each, scene, 5.0) for each in (world, beside))
    assert told == walked
    assert 0 < told < 1
    robots = unaware.robots
    assert robots == sorted(robots, reverse=True), "who collided is driven no further"
    assert robots[0] == 32 > robots[-1] >= 32 * told


@pytest.mark.parametrize(
    ("samples", "until_s", "told"), [(0, 1.0, "samples"), (1, torch.inf, "until_s")]
)
def test_nothing_to_try_is_refused(samples, until_s, told):
    with pytest.raises(ValueError, match=told):
        AvoidanceSearch(samples)(world_with(1.0), SCENARIO.cases("train", [0]), until_s)


def test_the_way_has_to_be_free_beyond_the_collision(monkeypatch):
    """But no longer than the episode lasts."""
    asked = []
    monkeypatch.setattr(AvoidanceSearch, "__call__", lambda *told: asked.append(told[-1]) or 1.0)
    cases = [{"case": 0, "outcome": "collision", "time_s": time_s} for time_s in (3.0, 9.5)]
    AvoidanceSearch(8).judge(world_with(1.0), SCENARIO, "train", cases)
    assert asked == [3.75, 10.0]
