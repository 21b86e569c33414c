"""Whole episodes against the recordings of the original environment."""

import numpy as np
import pytest
import torch

from diffstack_mmv.simulation import (
    CircleCrossing,
    Decided,
    HolonomicRobot,
    OrcaPolicy,
    SquareCrossing,
    StraightLine,
    UnicycleRobot,
    drive,
)
from diffstack_mmv.types import Outcome

KINDS = ("linear_invisible", "orca_invisible", "orca_visible", "unicycle_invisible")
RECORDINGS = [f"{scenario}_crossing_{kind}" for scenario in ("circle", "square") for kind in KINDS]
POLICIES = {"linear": StraightLine(), "orca": OrcaPolicy()}


class Replay:
    """Repeat recorded actions; the state is the number of the step."""

    def __init__(self, actions):
        self.actions = torch.from_numpy(np.nan_to_num(actions))

    def init(self, observation):
        return 0

    def act(self, state, observation):
        return Decided(self.actions[:, state], state + 1)


def check(record, recorded, slack=0.0):
    """Compare everything that was recorded; `slack` for sines that differ in a digit."""
    steps = recorded["length"]
    rows = np.arange(recorded["reward"].shape[1]) < steps[:, None]
    points = np.arange(recorded["reward"].shape[1] + 1) <= steps[:, None]
    uneasy = rows & (recorded["info"] == Outcome.DISCOMFORT)
    assert np.array_equal(record.steps, steps)
    assert np.array_equal(record.outcome, recorded["info"][np.arange(len(steps)), steps - 1])
    pairs = [
        (record.reward.numpy()[rows], recorded["reward"][rows]),
        (record.motion.position.numpy()[points], recorded["robot_pos"][points]),
        (record.clearance[:, 1:].numpy()[uneasy], recorded["danger_dist"][uneasy]),
    ]
    if "human_pos" in recorded:
        pairs.append((record.pedestrians.numpy()[points], recorded["human_pos"][points]))
    for ours, theirs in pairs:
        assert np.allclose(ours, theirs, rtol=0, atol=slack)


@pytest.fixture
def setting(recording, scenario_of, world_with):
    def load(name):
        recorded = recording(f"episodes_{name}_cases000-099")
        robot = UnicycleRobot() if "unicycle" in name else HolonomicRobot()
        world = world_with(robot=robot, visible=bool(recorded["visible"]))
        return recorded, world, scenario_of(name).cases("test", recorded["cases"].tolist())

    return load


@pytest.mark.parametrize("name", RECORDINGS)
def test_recorded_actions_give_the_recorded_verdicts_rewards_and_paths(setting, name):
    recorded, world, scene = setting(name)
    record, _ = drive(world, scene, Replay(recorded["action"]))
    check(record, recorded, slack=1e-12 if "unicycle" in name else 0.0)


@pytest.mark.parametrize("name", [name for name in RECORDINGS if "unicycle" not in name])
def test_policies_of_the_benchmark_give_the_recorded_episodes(setting, name):
    recorded, world, scene = setting(name)
    record, _ = drive(world, scene, POLICIES[name.split("_")[2]])
    check(record, recorded, slack=1e-12 if "linear" in name else 0.0)


def test_the_orca_robot_of_the_benchmark_has_the_published_figures(world_with):
    scene = CircleCrossing().cases("test", range(500))
    record, _ = drive(world_with(), scene, OrcaPolicy())
    success = record.outcome == Outcome.SUCCESS
    assert int(success.sum()) == 213
    assert int((record.outcome == Outcome.COLLISION).sum()) == 284
    assert int((record.outcome == Outcome.TIMEOUT).sum()) == 3
    assert round(float(record.duration[success].mean()), 4) == 10.8627


@pytest.mark.parametrize("scenario", [CircleCrossing(), SquareCrossing()], ids=["circle", "square"])
def test_the_exact_verdict_leaves_no_collision_unseen(world_with, scenario):
    world = world_with(exact=True, limit_s=10.0)
    record, _ = drive(world, scenario.cases("test", range(50)), StraightLine(2.5))
    offset = record.motion.position[:, :, None] - record.pedestrians
    overlaps = (offset.norm(dim=-1) < 0.6 - 1e-9).any(dim=-1).any(dim=-1)
    assert overlaps.any()
    assert (record.outcome[overlaps] == Outcome.COLLISION).all()


def test_an_episode_that_ended_repeats_its_last_row(world_with):
    record, _ = drive(world_with(), CircleCrossing().cases("test", range(10)), StraightLine())
    early = int(record.steps.argmin())
    end = int(record.steps[early])
    assert end < record.controls.shape[1]
    assert (record.motion.position[early, end:] == record.motion.position[early, end]).all()
    assert (record.reward[early, end:] == 0).all()


def test_a_standing_robot_runs_out_of_time_exactly_at_the_limit(world_with, scene_with):
    world = world_with(exact=True, limit_s=3.0)
    scene = scene_with(pedestrian=(9.0, 9.0), goal=(9.0, 9.0))
    scene = type(scene)(
        *(field[None] for field in scene[:3]),
        type(scene.pedestrians)(*(f[None] for f in scene.pedestrians)),
    )
    record, _ = drive(world, scene, Replay(np.zeros((1, 12, 2))))
    assert record.steps.tolist() == [12]
    assert record.duration.tolist() == [3.0]


@pytest.mark.parametrize("policy", [StraightLine, OrcaPolicy])
def test_a_policy_without_speed_is_refused(policy):
    with pytest.raises(ValueError, match="`speed_mps` must be positive"):
        policy(speed_mps=0.0)


class Answering:
    """Answers with what a function makes of the observation."""

    def __init__(self, answer):
        self.answer = answer

    def init(self, observation):
        return None

    def act(self, state, observation):
        return self.answer(torch.zeros_like(observation.motion.position))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("controller", "error", "told"),
    [
        (Answering(lambda still: still), TypeError, "return an action and the state .* got Tensor"),
        (Answering(lambda still: None), TypeError, "but got NoneType from Answering.act"),
        (Answering(lambda still: Decided(still[:2], None)), ValueError, r"row per episode, \(5,\)"),
        (Answering(lambda still: Decided(still[0], None)), ValueError, r"row per episode, \(5,\)"),
        (Answering, TypeError, "`controller` must have init and act, but got Answering"),
        (object(), TypeError, "`controller` must have init and act, but got object"),
    ],
)
def test_a_controller_that_answers_otherwise_is_told(world_with, controller, error, told):
    with pytest.raises(error, match=told):
        drive(world_with(), CircleCrossing().cases("test", range(5)), controller)
