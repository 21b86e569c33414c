"""What each verdict makes of the same step."""

import math

import pytest
import torch

from diffstack_mmv.simulation import (
    CrowdNavVerdict,
    DiscFootprint,
    ExactVerdict,
    RectangleFootprint,
)
from diffstack_mmv.simulation.pedestrians import CrowdState
from diffstack_mmv.simulation.verdict import Encounter, RobotPath, clearance_at_rest
from diffstack_mmv.types import Motion, Outcome

VERDICTS = [CrowdNavVerdict(10.0), ExactVerdict(10.0)]
BOTH = pytest.mark.parametrize("verdict", VERDICTS, ids=["crowdnav", "exact"])
CROWDNAV, EXACT = VERDICTS


def vector(x, y):
    return torch.tensor((float(x), float(y)), dtype=torch.float64)


def encounter(pedestrian=(0, 5), old=(0, 0), new=(0, 0), end=(0, 0.25), goal=(0, 8), time=0.0):
    """One step of 0.25 s of a robot from the origin to `end` beside one pedestrian."""
    end, pedestrian = vector(*end), vector(*pedestrian)[None]
    one = torch.ones(1, dtype=torch.float64)
    return Encounter(
        path=RobotPath(
            torch.stack((torch.zeros_like(end), end)), torch.zeros(2, dtype=torch.float64)
        ),
        footprint=DiscFootprint(),
        velocity=end / 0.25,
        pedestrians=CrowdState(pedestrian, vector(*old)[None], pedestrian, 0.3 * one, one),
        pedestrian_velocity=vector(*new)[None],
        goal=vector(*goal),
        time=torch.tensor(float(time), dtype=torch.float64),
        dt_s=0.25,
    )


@BOTH
@pytest.mark.parametrize(
    ("step", "outcome", "reward"),
    [
        (encounter(), Outcome.RUNNING, 0.0),
        (encounter(pedestrian=(0.7, 0)), Outcome.DISCOMFORT, (0.1 - 0.2) * 0.5 * 0.25),
        (encounter(pedestrian=(0, 0.7)), Outcome.COLLISION, -0.25),
        (encounter(goal=(0, 0.5)), Outcome.SUCCESS, 1.0),
        (encounter(goal=(0, 0.5), pedestrian=(0, 0.7)), Outcome.COLLISION, -0.25),
        (encounter(time=9.75), Outcome.TIMEOUT, 0.0),
    ],
    ids=["nothing", "near", "hit", "goal", "hit at the goal", "late"],
)
def test_outcome_and_reward_of_plain_steps(verdict, step, outcome, reward):
    judgement = verdict(step)
    assert judgement.outcome == outcome
    assert judgement.reward == pytest.approx(reward, abs=1e-12)


@pytest.mark.parametrize(
    ("step", "exact"),
    [
        (encounter(pedestrian=(0, 0.7), time=9.75), Outcome.COLLISION),
        (encounter(goal=(0, 0.5), time=9.75), Outcome.SUCCESS),
        (encounter(time=9.0), Outcome.RUNNING),
    ],
    ids=["collision", "goal", "a second early"],
)
def test_the_original_timeout_hides_what_the_exact_one_sees(step, exact):
    assert CROWDNAV(step).outcome == Outcome.TIMEOUT
    assert EXACT(step).outcome == exact


def test_the_original_tests_old_velocities_and_the_exact_one_those_of_the_step():
    comes = encounter(pedestrian=(1.0, 0), old=(0, 0), new=(-2.0, 0), end=(0, 0))
    stops = encounter(pedestrian=(1.0, 0), old=(-2.0, 0), new=(0, 0), end=(0, 0))
    assert [int(CROWDNAV(step).outcome) for step in (comes, stops)] == [0, Outcome.COLLISION]
    assert [int(EXACT(step).outcome) for step in (comes, stops)] == [Outcome.COLLISION, 0]


def test_the_exact_verdict_follows_a_bent_path():
    step = encounter(pedestrian=(0.7, 0.5), end=(0, 1.0))
    bend = torch.stack((vector(0, 0), vector(0.5, 0.5), vector(0, 1.0)))
    bent = step._replace(path=RobotPath(bend, torch.zeros(3, dtype=torch.float64)))
    assert EXACT(step).outcome == Outcome.DISCOMFORT
    assert EXACT(bent).outcome == Outcome.COLLISION


@BOTH
def test_clearance_is_that_to_the_nearest_pedestrian(verdict):
    step = encounter(pedestrian=(1.0, 0), end=(0, 0))
    crowd = CrowdState(*(field.repeat_interleave(2, dim=0) for field in step.pedestrians))
    crowd.position[1] = vector(3, 0)
    still = torch.zeros(2, 2, dtype=torch.float64)
    judgement = verdict(step._replace(pedestrians=crowd, pedestrian_velocity=still))
    assert judgement.clearance == pytest.approx(0.4)


def test_clearance_at_rest_is_that_of_the_outline_wherever_the_robot_is():
    crowd = encounter(pedestrian=(4.0, 2.5)).pedestrians
    heading = torch.tensor(math.pi / 2, dtype=torch.float64)
    motion = Motion(vector(4, 1), heading, vector(0, 0), heading)
    footprint = RectangleFootprint(1.8, 0.6, ahead_m=0.2)
    assert float(clearance_at_rest(motion, footprint, crowd)) == pytest.approx(1.5 - 1.1 - 0.3)
    nobody = type(crowd)(*(field[:0] for field in crowd))
    assert float(clearance_at_rest(motion, footprint, nobody)) == math.inf


@pytest.mark.parametrize("kind", [CrowdNavVerdict, ExactVerdict])
@pytest.mark.parametrize(("tolerance", "outcome"), [(0.25, 0), (0.2500001, Outcome.SUCCESS)])
def test_the_goal_is_reached_where_a_step_ends_closer_than_its_tolerance(kind, tolerance, outcome):
    assert kind(10.0, tolerance)(encounter(goal=(0, 0.5))).outcome == outcome


@pytest.mark.parametrize("limit", [0.0, -5.0, float("nan")])
def test_a_limit_that_is_not_positive_is_refused(limit):
    with pytest.raises(ValueError, match="`limit_s` must be positive"):
        ExactVerdict(limit)


def test_a_limit_that_the_early_timeout_swallows_is_refused():
    with pytest.raises(ValueError, match="take a later limit"):
        CrowdNavVerdict(1.0)
