"""Many crowds as one vectorised environment."""

import gymnasium
import numpy as np
import pytest
import torch

from diffstack_mmv.simulation import (
    ENV_ID,
    CircleCrossing,
    CrowdNavEnv,
    CrowdNavVectorEnv,
    DiscFootprint,
    EgoView,
    vehicle_robot,
)
from diffstack_mmv.types import Outcome


@pytest.fixture
def crowds(world_with, driven):
    def build(count=3, limit_s=10.0, robot=None, **settings):
        robot = robot or vehicle_robot(driven(), footprint=DiscFootprint())
        world = world_with(robot, exact=True, limit_s=limit_s)
        return CrowdNavVectorEnv(world, CircleCrossing(), count, **settings)

    return build


def test_each_row_is_the_episode_of_the_single_environment(crowds):
    many = crowds()
    single = CrowdNavEnv.from_world(many.world, many.scenario)
    seen, told = many.reset(options={"phase": "test", "cases": [4, 7, 9]})
    assert told["case"].tolist() == [4, 7, 9]
    actions = np.tile([1.0, 0.1], (3, 1))
    alone, _ = single.reset(options={"phase": "test", "case": 7})
    for _ in range(5):
        assert all(np.array_equal(seen[name][1], alone[name]) for name in alone)
        seen, reward, *_ = many.step(actions)
        alone, expected, *_ = single.step(actions[1])
        assert reward[1] == expected


def test_who_has_ended_starts_anew_and_the_others_go_on(crowds):
    many = crowds(limit_s=1.0)
    many.reset(seed=3)
    for _ in range(3):
        *_, truncated, _ = many.step(np.zeros((3, 2)))
        assert not truncated.any()
    seen, _, terminated, truncated, told = many.step(np.zeros((3, 2)))
    assert truncated.all()
    assert not terminated.any()
    assert (told["outcome"] == Outcome.TIMEOUT).all()
    assert told["_final_obs"].all()
    assert (many.state.time == 0).all()
    assert not np.array_equal(told["final_obs"]["humans"], seen["humans"])


def test_what_is_told_can_be_written_to(crowds):
    many = crowds()
    many.reset(seed=3)
    *_, told = many.step(np.zeros((3, 2)))
    told["time_s"][:] = 9.0
    assert (many.state.time == 0.25).all()


def test_a_row_that_starts_anew_leaves_its_mates_alone(crowds):
    many, alone = crowds(), crowds()
    for env in (many, alone):
        env.reset(options={"phase": "test", "cases": [0, 1, 2]})
    # a step ahead of its mates in time, the first one is out of time first
    late = many.state._replace(time=torch.tensor([9.75, 0.0, 0.0], dtype=torch.float64))
    many._state = late
    seen, *_, truncated, _ = many.step(np.zeros((3, 2)))
    expected, *_ = alone.step(np.zeros((3, 2)))
    assert truncated.tolist() == [True, False, False]
    assert np.array_equal(seen["humans"][1:], expected["humans"][1:])
    assert many.state.time.tolist() == [0.0, 0.25, 0.25]


def test_coming_nearer_is_rewarded(crowds):
    plain, shaped = crowds(), crowds(progress_reward=2.0)
    gained = []
    for env in (plain, shaped):
        env.reset(options={"phase": "test", "cases": [0, 1, 2]})
        for _ in range(2):
            before = env.world.way_left(env.state)
            _, reward, *_ = env.step(np.tile([2.0, 0.0], (3, 1)))
        gained.append(reward)
    nearer = (before - shaped.world.way_left(shaped.state)).numpy()
    assert gained[1] - gained[0] == pytest.approx(2.0 * nearer)
    assert (nearer > 0).all()


@pytest.mark.parametrize("nearest", [2, 7])
def test_the_view_from_the_robot_is_of_its_space_and_turns_with_it(crowds, nearest):
    many = crowds(view=EgoView(nearest=nearest))
    seen, _ = many.reset(seed=0)
    assert many.observation_space.contains(seen)
    assert seen.shape == (3, 7 + 6 * nearest)
    # the goal lies ahead: 8 m in units of 5 m
    assert seen[:, :3] == pytest.approx(np.tile([1.6, 0.0, 1.6], (3, 1)), abs=1e-6)
    gaps = seen[:, 7:].reshape(3, nearest, 6)[:, : min(nearest, 5), -1]
    assert (np.diff(gaps, axis=1) >= 0).all()
    assert not seen[:, 7 + 6 * 5 :].any()


def test_gymnasium_makes_it_by_its_name():
    env = gymnasium.make_vec(ENV_ID, num_envs=2, robot="unicycle", scenario="square_crossing")
    assert isinstance(env, CrowdNavVectorEnv)
    seen, _ = env.reset(seed=1)
    assert env.observation_space.contains(seen)


def test_each_picture_is_that_of_the_single_environment():
    envs = gymnasium.make_vec(ENV_ID, num_envs=2, robot="unicycle", render_mode="rgb_array")
    envs.reset(options={"phase": "test", "cases": [3, 4]})
    alone = CrowdNavEnv(robot="unicycle", render_mode="rgb_array")
    alone.reset(options={"phase": "test", "case": 4})
    pictures = envs.render()
    assert len(pictures) == 2
    assert np.array_equal(pictures[1], alone.render())
    assert envs.metadata["render_fps"] == 4


def test_without_a_render_mode_nothing_is_drawn(crowds):
    envs = crowds()
    envs.reset(seed=0)
    assert envs.render() is None


def test_an_unknown_render_mode_is_refused(crowds):
    with pytest.raises(ValueError, match="`render_mode` must be one of rgb_array"):
        crowds(render_mode="human")


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("count", [2.5, "a", None])
def test_a_number_of_episodes_that_is_none_is_refused(count, crowds):
    with pytest.raises(ValueError, match="`num_envs` must be a whole number"):
        crowds(count=count)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("options", [{"cases": [1]}, {"case": [1, 2, 3]}, {"cases": [1.5, 2, 3]}])
def test_wrong_options_are_refused(crowds, options):
    with pytest.raises(ValueError, match=r"`case` must be a whole|cases|options"):
        crowds().reset(options=options)


def test_there_is_no_state_before_the_first_reset(crowds):
    with pytest.raises(RuntimeError, match="reset"):
        crowds().step(np.zeros((3, 2)))


@pytest.mark.parametrize("phase", ["train", "val", "test"])
def test_cases_are_drawn_from_the_phase_and_told(crowds, phase):
    envs = crowds(count=3, limit_s=0.5)
    _, told = envs.reset(seed=0, options={"phase": phase})
    begun = [told["case"]]
    for _ in range(3):
        *_, told = envs.step(np.zeros(envs.action_space.shape))
        begun.append(told["case"])
    assert (begun[-1] != begun[0]).all()
    state = envs.world.start(envs.scenario.cases(phase, begun[-1].tolist()))
    assert torch.allclose(state.goal, envs.state.goal)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"cases": 5}, "`cases` must be 3, one per episode, but got 1"),
        ({"phase": "sunday"}, "`phase` must be one of"),
    ],
)
def test_cases_that_there_are_not_are_refused(crowds, options, told):
    with pytest.raises(ValueError, match=told):
        crowds(count=3).reset(options=options)
