"""Crowds that walk on to new goals."""

from dataclasses import replace

import pytest
import torch

from diffstack_mmv.simulation import LimitedSensing, WanderingCrossing


@pytest.fixture
def crossing():
    return WanderingCrossing(
        humans=8, circle_radius_m=6.0, radius_max_m=0.5, speed_min_mps=0.5, speed_max_mps=1.5,
        change_chance=0.5,
    )  # fmt: skip


def test_a_case_is_a_number_and_keeps_its_distances(crossing):
    scene = crossing.cases("val", range(6))
    again = crossing.case("val", 3)
    assert torch.equal(scene.pedestrians.position[3], again.pedestrians.position)
    assert torch.equal(scene.itinerary.goals[3], again.itinerary.goals)
    way = scene.robot_goal - scene.robot_position
    assert float(way.norm(dim=-1).min()) >= 6.0
    assert torch.allclose(torch.atan2(way[:, 1], way[:, 0]), scene.robot_heading)
    place, radius = scene.pedestrians.position, scene.pedestrians.radius
    gap = torch.cdist(place, place) - radius[..., None] - radius[..., None, :]
    gap = gap + 1e3 * torch.eye(8)
    assert float(gap.min()) >= crossing.clearance_m
    assert 0.3 <= float(radius.min()) < float(radius.max()) <= 0.5
    assert float(scene.pedestrians.preferred_speed.min()) >= 0.5


def test_goals_change_on_arrival_and_at_the_moments_drawn(crossing, world_with):
    world = world_with(limit_s=50.0)
    state = world.start(crossing.cases("val", (0, 1)))
    before = state
    for _ in range(40):
        state = world.step(state, torch.zeros(2, 2)).state
        due = abs(float(state.time[0]) - 5.0) < 1e-6 or abs(float(state.time[0]) - 10.0) < 1e-6
        arrived = (before.pedestrians.goal - state.pedestrians.position).norm(
            dim=-1
        ) < state.pedestrians.radius
        changed = (before.pedestrians.goal != state.pedestrians.goal).any(-1)
        if not due:
            assert torch.equal(changed, arrived)
        before = state
    assert bool((state.itinerary.taken > 0).any())


@pytest.mark.parametrize(("every_s", "changes"), [(7.0, 12), (5.0, 12), (1.0, 60)])
def test_goals_may_be_given_up_until_the_latest_limit(crossing, every_s, changes):
    restless = replace(crossing, change_every_s=every_s, change_chance=1.0)
    itinerary = restless.case("val", 0).itinerary
    assert itinerary.times.tolist() == [every_s * number for number in range(1, changes + 1)]
    assert itinerary.gives_up.shape == (8, changes)
    assert itinerary.goals.shape[-2] >= changes


def test_the_robot_of_a_limited_sensor_still_meets_everybody(crossing, world_with):
    world = world_with()
    state = world.start(crossing.cases("val", (0,)))
    told = LimitedSensing(range_m=2.0)(world.observe(state))
    assert told.seen.shape == (1, 8)
    assert not bool(told.seen.all())
