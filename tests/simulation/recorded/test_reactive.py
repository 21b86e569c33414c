"""Recorded people who step aside for the robot, and otherwise walk as recorded."""

import pytest
import torch

from diffstack_mmv.geometry import length
from diffstack_mmv.simulation import (
    ExactVerdict,
    HolonomicRobot,
    ReactiveReplayCrowd,
    RecordedCrossing,
    ReplayCrowd,
    World,
    study_world,
)
from diffstack_mmv.simulation.pedestrians import VisibleRobot
from tests.simulation.recorded.conftest import Reader, recorded


@pytest.fixture
def walker():
    """One person who walks along x through the origin, and the robot beside it."""

    def build(robot_at):
        time = 0.1 * torch.arange(201, dtype=torch.float64)
        way = torch.stack((1.2 * (time - 10), 0 * time), -1)[None]
        reader = Reader({"test": {"one": recorded(way)}})
        scenario = RecordedCrossing(reader, history_s=2.0, met=0, blind_mps=0.0, limit_s=10.0)
        scene = scenario.cases("test", [0])
        crowd = scene.pedestrians
        lead = int(crowd.lead[0])
        start = crowd.track[0, 0, lead]
        ahead = crowd.track[0, 0, lead + 12] - start
        unit = ahead / ahead.norm()
        aside = torch.stack((-unit[1], unit[0]))
        place = start + ahead + robot_at * aside + 0.05 * aside
        return scene._replace(robot_position=place[None], robot_goal=place[None] + 50)

    return build


def walked(crowd, scene, steps=30):
    """Positions of the first person beside its recording, and the smallest clearance."""
    world = World(HolonomicRobot(), crowd, ExactVerdict(10.0), robot_visible=True)
    state, apart, clearance = world.start(scene), [], []
    for _ in range(steps):
        state, judgement = world.step(state, torch.zeros_like(state.goal))
        now = state.pedestrians
        apart.append(float(length(now.position - now.recorded(0))[0, 0]))
        clearance.append(float(judgement.clearance[0]))
    return apart, min(clearance)


def test_who_meets_the_robot_steps_aside_and_returns(walker):
    scene = walker(0.0)
    assert walked(ReplayCrowd(), scene)[1] < 0
    apart, clearance = walked(ReactiveReplayCrowd(), scene)
    assert clearance > 0
    assert max(apart) > 0.3
    assert apart[-1] < 0.1


def test_who_is_far_from_the_robot_walks_as_recorded(walker):
    apart, _ = walked(ReactiveReplayCrowd(), walker(30.0))
    assert max(apart) < 1e-9


def test_without_a_robot_everybody_walks_as_recorded(crossing):
    crowd = crossing().cases("test", range(2)).pedestrians
    assert torch.equal(ReactiveReplayCrowd()(crowd, 0.25), ReplayCrowd()(crowd, 0.25))


@pytest.mark.usefixtures("social_force_library")
@pytest.mark.slow
def test_social_forces_can_do_it_as_well(walker):
    from diffstack_mmv.simulation import SocialForceCrowd

    apart, _ = walked(ReactiveReplayCrowd(SocialForceCrowd()), walker(0.0), steps=16)
    assert max(apart) > 0.05


def test_a_batch_reacts_as_its_cases(crossing):
    crowd = crossing().cases("test", range(2)).pedestrians
    robot = VisibleRobot(
        crowd.position[:, 0] + 0.8, torch.zeros(2, 2).double(), torch.ones(2).double() * 0.3
    )
    together = ReactiveReplayCrowd()(crowd, 0.25, robot)
    for case in range(2):
        one = type(crowd)(*(each[case : case + 1] for each in crowd))
        seen = VisibleRobot(*(each[case : case + 1] for each in robot))
        assert torch.allclose(ReactiveReplayCrowd()(one, 0.25, seen), together[case : case + 1])


def test_a_study_shows_them_the_robot(driven):
    from diffstack_mmv.simulation import vehicle_robot

    robot = vehicle_robot(driven())
    assert study_world(robot, ReactiveReplayCrowd(), "exact", 10.0, 0.25).robot_visible
    assert not study_world(robot, ReplayCrowd(), "exact", 10.0, 0.25).robot_visible
