"""Vehicles that are nearly there get there."""

import math
from dataclasses import replace

import pytest
import torch

from diffstack_mmv.crowdnav import CrowdNav
from diffstack_mmv.types import Outcome, map_tensors

STARTS = [(0.4, 90, 0.7), (0.4, 90, 1.0), (0.4, 90, 1.5), (0.5, 90, 1.0), (0.8, 60, 1.0)]
"""m, degrees and m/s: how far the goal is, on which side, and how fast the vehicle is."""


def beside_its_goal(study, world):
    """A vehicle under way close to its goal, everybody else far away."""
    distance, bearing, speed = torch.tensor(STARTS, dtype=torch.float64).unbind(-1)
    scene = study.cases().cases("train", range(1))
    scene = map_tensors(lambda entry: entry.repeat_interleave(len(STARTS), 0), scene)
    angle = scene.robot_heading + bearing * math.pi / 180
    way = distance[:, None] * torch.stack([angle.cos(), angle.sin()], -1)
    people = scene.pedestrians
    far = people._replace(position=people.position + 60, goal=people.goal + 60)
    state = world.start(scene._replace(robot_goal=scene.robot_position + way, pedestrians=far))
    model = state.robot.model.clone()
    model[:, world.robot.model.State._fields.index("velocity_forward")] = speed
    return state._replace(robot=state.robot._replace(model=model))


@pytest.mark.slow
@torch.no_grad()
def test_a_wheelchair_does_not_circle_around_its_goal():
    # of driven wheels and casters: the tightest turn is of 0.36 m at 0.4 m/s and of 0.5 m at 1 m/s
    study = CrowdNav("wheelchair", "gm3")
    world, driver = study.world(), study.driver()
    driver.planner.starts = 0  # proposals alone, on tensors
    driver.planner.candidates.compile = False
    driver.planner.score = replace(driver.planner.score, compile=False)
    driver.planner.solver = replace(driver.planner.solver, compile=False)
    state = beside_its_goal(study, world)
    known = driver.init(world.observe(state))
    running = torch.ones(len(STARTS), dtype=torch.bool)
    outcome = torch.zeros(len(STARTS), dtype=torch.long)
    for _ in range(28):
        action, known = driver.act(known, world.observe(state)._replace(running=running))
        state, judgement = world.step(state, action)
        outcome = torch.where(running, judgement.outcome, outcome)
        running = running & (judgement.outcome < Outcome.COLLISION)
        if not running.any():
            break
    assert (outcome == Outcome.SUCCESS).all()
