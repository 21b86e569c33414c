"""A policy is trained in the vectorised crowd, kept, and driven; needs the extra `rl`."""

import dataclasses
from zipfile import ZipFile

import numpy as np
import pytest
import torch

from diffstack_mmv.simulation import (
    CircleCrossing,
    CrowdNavVectorEnv,
    DiscFootprint,
    EgoView,
    LearnedPolicy,
    drive,
    vehicle_robot,
)

pytest.importorskip("stable_baselines3", reason="needs the extra `rl`")


@pytest.fixture
def env(world_with, driven):
    world = world_with(vehicle_robot(driven(), footprint=DiscFootprint()), exact=True, limit_s=2.0)
    return CrowdNavVectorEnv(world, CircleCrossing(), 4, EgoView())


def test_a_trained_policy_drives(env, driven, tmp_path):
    from diffstack_mmv.simulation.reinforcement import PPOTraining

    training = PPOTraining(seconds=2.0, steps=8, minibatch=16, epochs=1, layers=(8,))
    curve = training(env, tmp_path / "policy.zip")
    assert list(curve[0]["outcomes"]) == ["collision", "success", "timeout"]
    assert sum(sum(row["outcomes"].values()) for row in curve) > 0
    policy = LearnedPolicy(tmp_path / "policy.zip", driven().model(0.05), lambda control: control)
    record, _ = drive(env.world, env.scenario.cases("val", range(2)), policy)
    lower, upper = env.world.robot.bounds
    assert bool(((record.controls >= lower) & (record.controls <= upper)).all())


def test_a_policy_that_is_not_written_whole_leaves_the_earlier_one(env, tmp_path, monkeypatch):
    from stable_baselines3 import PPO

    from diffstack_mmv.simulation.reinforcement import PPOTraining

    def break_off(_, stream):
        stream.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(PPO, "save", break_off)
    (tmp_path / "policy.zip").write_bytes(b"earlier")
    training = PPOTraining(seconds=1.0, steps=2, minibatch=4, epochs=1, layers=(8,))
    with pytest.raises(KeyboardInterrupt):
        training(env, tmp_path / "policy.zip")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"earlier"]


def test_an_interrupted_training_goes_on_with_what_it_has_learned(env, tmp_path, monkeypatch):
    from diffstack_mmv.simulation import reinforcement

    monkeypatch.setattr(reinforcement, "KEPT_EVERY_S", 0.0)
    first = reinforcement.PPOTraining(3.0, 4, 8, epochs=1, learning_rate=1.0, layers=(8,))
    step, left = env.step, iter(range(10))

    def broken_off(controls):
        if next(left, None) is None:
            raise KeyboardInterrupt
        return step(controls)

    monkeypatch.setattr(env, "step", broken_off)
    with pytest.raises(KeyboardInterrupt):
        first(env, tmp_path / "policy.zip")
    monkeypatch.setattr(env, "step", step)
    [kept] = tmp_path.iterdir()
    learned = reinforcement.PPO.load(kept).get_parameters()["policy"]

    second = dataclasses.replace(first, learning_rate=1e-9)  # stays where it begins
    curve = second(env, tmp_path / "policy.zip")
    policy = reinforcement.PPO.load(tmp_path / "policy.zip").get_parameters()["policy"]
    torch.testing.assert_close(policy, learned)
    assert [row["steps"] for row in curve] == [16 * (1 + row) for row in range(len(curve))]
    assert len(curve) > 2
    assert [each.name for each in tmp_path.iterdir()] == ["policy.zip"]


def test_a_training_without_any_update_is_none(env, tmp_path):
    from diffstack_mmv.simulation.reinforcement import PPOTraining

    training = PPOTraining(seconds=1e-6, steps=2, minibatch=4, epochs=1, layers=(8,))
    with pytest.raises(ValueError, match="`seconds` must suffice for an update of 8 steps"):
        training(env, tmp_path / "policy.zip")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("name", "value"), [("minibatch", 1), ("discount", 1.1), ("steps", 0)])
def test_what_no_training_can_have_is_refused(name, value):
    from diffstack_mmv.simulation.reinforcement import PPOTraining

    with pytest.raises(ValueError, match=f"`{name}` must"):
        PPOTraining(**{name: value})


def test_an_archive_of_something_else_is_no_policy(tmp_path):
    from diffstack_mmv.simulation.reinforcement import load_policy

    with ZipFile(tmp_path / "policy.zip", "w") as archive:
        archive.writestr("a", "b")
    with pytest.raises(ValueError, match="`policy` must be readable, but got AssertionError"):
        load_policy(tmp_path / "policy.zip")


def test_shares_of_the_bounds_become_controls(env):
    from diffstack_mmv.simulation.stable_baselines_env import StableBaselinesEnv

    adapted = StableBaselinesEnv(env)
    adapted.seed(3)
    first = adapted.reset()
    assert not np.array_equal(first, adapted.reset())
    # full braking at rest moves nobody
    place = env.world.robot.motion(env.state.robot).position
    adapted.step(-np.ones((4, 2)))
    assert torch.allclose(env.world.robot.motion(env.state.robot).position, place, atol=0.2)
    for _ in range(7):
        *_, ended, told = adapted.step(-np.ones((4, 2)))
    assert ended.all()
    assert all(each["TimeLimit.truncated"] for each in told)
    assert told[0]["terminal_observation"].shape == first[0].shape
