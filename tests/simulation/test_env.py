"""The environment as gymnasium sees it."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from diffstack_mmv.dynamics.catalogue import dynamics_names, model_of
from diffstack_mmv.simulation import (
    ENV_ID,
    CircleCrossing,
    CrowdNavEnv,
    DiscFootprint,
    SocialForceCrowd,
    World,
    robot_named,
)

ROBOTS = pytest.mark.parametrize("robot", ["holonomic", "unicycle", "bicycle", "wheelchair"])


def test_the_environment_is_registered_under_its_name():
    env = gymnasium.make(
        ENV_ID,
        scenario="circle_crossing",
        humans=5,
        dt_s=0.25,
        limit_s=25.0,
        robot="holonomic",
        verdict="crowdnav",
    )
    env.reset(options={"phase": "test", "case": 7})
    assert ENV_ID == "diffstack_mmv/CrowdNav-v0"
    assert isinstance(env.unwrapped, CrowdNavEnv)
    assert env.unwrapped.human_positions.shape == (5, 2)


@ROBOTS
@pytest.mark.filterwarnings("ignore:.*symmetric and normalized space.*")
@pytest.mark.parametrize("verdict", ["crowdnav", "exact"])
def test_every_robot_passes_the_checks_of_gymnasium(robot, verdict):
    env = gymnasium.make(ENV_ID, robot=robot, verdict=verdict, render_mode="rgb_array")
    check_env(env.unwrapped)


@pytest.mark.parametrize("dynamics", ["unicycle", "kbm", "gm3"])
def test_a_vehicle_drives_with_the_dynamics_it_is_given(dynamics):
    env = CrowdNavEnv(robot="bicycle", dynamics=dynamics)
    env.reset(options={"phase": "test", "case": 0})
    names = env.world.robot.model.Control._fields
    for _ in range(4):
        env.step(np.array([1.0 * (name == "acceleration") for name in names]))
    assert env.robot_position == pytest.approx((0.0, -3.5), abs=0.05)


@pytest.mark.parametrize("scenario", ["circle", "square"])
def test_a_case_starts_and_goes_on_as_recorded(recording, scenario):
    recorded = recording(f"{scenario}_crossing_h5_dt025_cases000-099")
    env = CrowdNavEnv(scenario=f"{scenario}_crossing")
    env.reset(options={"phase": "test", "case": 7})
    for step in range(10):
        assert np.allclose(env.human_positions, recorded["positions"][7, step], rtol=0, atol=1e-12)
        env.step(np.zeros(2))


def test_recorded_episodes_end_as_recorded(recording):
    recorded = recording("episodes_circle_crossing_orca_invisible_cases000-099")
    env = CrowdNavEnv()
    for case in range(5):
        env.reset(options={"phase": "test", "case": case})
        for step in range(recorded["length"][case]):
            _, reward, terminated, truncated, told = env.step(recorded["action"][case, step])
            assert reward == recorded["reward"][case, step]
        assert terminated or truncated
        assert told["time_s"] == recorded["global_time"][case]


def test_a_case_that_is_given_leaves_the_cases_that_are_drawn_later():
    env = CrowdNavEnv()
    first = env.reset(seed=0)[1]
    assert env.reset(seed=0, options={"case": 3})[1]["case"] == 3
    assert env.reset()[1] == first


def test_a_seed_without_a_case_always_draws_the_same_case():
    first, second = (CrowdNavEnv().reset(seed=11) for _ in range(2))
    assert first[1] == second[1]
    assert np.array_equal(first[0]["humans"], second[0]["humans"])


@ROBOTS
def test_observations_lie_in_their_space_during_an_episode(robot):
    env = CrowdNavEnv(robot=robot, humans=3, limit_s=5.0)
    observation, _ = env.reset(options={"phase": "val", "case": 2})
    for _ in range(5):
        assert env.observation_space.contains(observation)
        observation, *_ = env.step(env.action_space.high * 0.2)


def test_a_scene_of_ones_own_can_be_started():
    scene = CircleCrossing(humans=2).case("val", 5)
    env = CrowdNavEnv(humans=2)
    env.reset(options={"scene": scene})
    assert np.array_equal(env.human_positions, scene.pedestrians.position.numpy())


def test_a_picture_has_height_width_and_three_colours():
    env = CrowdNavEnv(render_mode="rgb_array", robot="unicycle")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (480, 480, 3)
    assert picture.dtype == np.uint8
    assert picture.std() > 0


def test_without_a_render_mode_nothing_is_drawn():
    env = CrowdNavEnv()
    env.reset(seed=0)
    assert env.render() is None


def test_a_visible_robot_changes_the_way_of_the_pedestrians():
    places = []
    for visible in (True, False):
        env = CrowdNavEnv(robot_visible=visible)
        env.reset(options={"phase": "test", "case": 1})
        for _ in range(20):
            env.step(np.array((0.0, 0.5)))
        places.append(env.human_positions)
    assert not np.allclose(places[0], places[1])


def test_any_world_becomes_an_environment(world_with):
    env = CrowdNavEnv.from_world(world_with(dt_s=0.1), CircleCrossing(humans=9))
    observation, _ = env.reset(seed=0)
    assert observation["humans"].shape == (9, 5)


@pytest.mark.usefixtures("social_force_library")
@pytest.mark.slow
def test_social_force_pedestrians_walk_in_the_environment(world_with):
    usual = world_with()
    world = World(usual.robot, SocialForceCrowd(), usual.verdict)
    env = CrowdNavEnv.from_world(world, CircleCrossing())
    start, _ = env.reset(seed=0)
    for _ in range(8):
        after, *_ = env.step(np.zeros(2))
    assert (np.linalg.norm(after["humans"][:, :2] - start["humans"][:, :2], axis=1) > 0.5).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"scenario": "spiral"}, "`scenario` must be one of circle_crossing, square_crossing"),
        ({"humans": -1}, "`humans` must be at least 0"),
        ({"humans": 2.5}, "`humans` must be a whole number, but got 2.5"),
        ({"humans": "a"}, "`humans` must be a whole number, but got 'a'"),
        ({"humans": True}, "`humans` must be a whole number, but got True"),
        ({"dt_s": "a"}, "`dt_s` must be a number, but got 'a'"),
        ({"dt_s": "0.25"}, "`dt_s` must be a number, but got '0.25'"),
        ({"robot": 3}, "`robot` must be a name, a YAML file or a robot, but got 3"),
        ({"robot": "bicycle", "dynamics": 3}, "`dynamics` must be one of"),
        ({"dt_s": 0.0}, "`dt_s` must be positive"),
        ({"limit_s": -1.0}, "`limit_s` must be positive"),
        ({"limit_s": 10.1}, "`limit_s` must be a multiple of 0.25"),
        ({"robot": "carpet"}, "`vehicle` must be one of"),
        ({"robot": "bicycle", "footprint": "oval"}, "`footprint` must be one of disc, vehicle"),
        ({"footprint": "vehicle"}, "`footprint` must be disc.* for robot 'holonomic'"),
        ({"dynamics": "kbm"}, "`dynamics` must not be given, but got 'kbm' for robot 'holonomic'"),
        ({"robot": "bicycle", "dynamics": "magic"}, "`dynamics` must be one of"),
        ({"verdict": "mild"}, "`verdict` must be one of crowdnav, exact"),
        ({"render_mode": "pedestrian"}, "`render_mode` must be one of rgb_array"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_impossible_settings_are_refused_by_name(settings, message):
    with pytest.raises(ValueError, match=message):
        CrowdNavEnv(**settings)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"phase": "exam"}, "`phase` must be one of"),
        ({"phase": "test", "case": 5000}, "`case` must lie in"),
        ({"case": 1.5}, "`case` must be a whole number, but got 1.5"),
        ({"case": "a"}, "`case` must be a whole number, but got 'a'"),
        ({"number": 3}, "`options` must be one of"),
        ({"scene": "here"}, "`scene` must be a Scene"),
    ],
)
def test_impossible_options_are_refused_by_name(options, message):
    with pytest.raises(ValueError, match=message):
        CrowdNavEnv().reset(options=options)


@pytest.mark.parametrize("action", [np.full(2, np.nan), np.zeros(3)])
def test_impossible_actions_are_refused(action):
    env = CrowdNavEnv()
    env.reset(seed=0)
    with pytest.raises(ValueError, match="`action` must"):
        env.step(action)


def test_a_step_before_the_start_or_after_the_end_is_refused():
    env = CrowdNavEnv(limit_s=1.25)
    with pytest.raises(RuntimeError, match="Call `reset`"):
        env.step(np.zeros(2))
    env.reset(seed=0)
    for _ in range(2):
        env.step(np.zeros(2))
    with pytest.raises(RuntimeError, match="Call `reset`"):
        env.step(np.zeros(2))


@pytest.mark.parametrize("dt_s", [0.25, 0.1, 0.033])
def test_the_fine_step_of_a_vehicle_divides_the_step_and_is_short_enough(dt_s):
    robot = robot_named("bicycle", "kbm", dt_s)
    pieces = dt_s / robot.model.dt_s
    assert robot.model.dt_s <= 0.01 + 1e-12
    assert pieces == pytest.approx(round(pieces))
    assert robot.bounds.lower.dtype == torch.float64


@pytest.mark.parametrize("dynamics", dynamics_names())
def test_a_vehicle_takes_any_dynamics_of_the_configuration(dynamics):
    env = CrowdNavEnv(robot="bicycle", dynamics=dynamics)
    model = env.world.robot.model
    assert model.description() == model_of("bicycle", dynamics, model.dt_s).description()


def test_a_vehicle_has_the_disc_of_the_benchmark_or_its_box():
    disc, box = (
        CrowdNavEnv(robot="bicycle", dynamics="kbm", footprint=name).world.robot.footprint
        for name in ("disc", "vehicle")
    )
    assert disc == DiscFootprint(0.3)
    assert (box.length_m, box.width_m, box.ahead_m) == pytest.approx((1.8, 0.6, 0.525))


def test_an_observation_tells_the_discs_that_cover_the_robot():
    env = CrowdNavEnv(robot="bicycle", footprint="vehicle")
    env.reset(seed=0)
    seen = env.world.observe(env.state)
    assert seen.discs.ahead.shape == (3,)
    assert seen.radius == pytest.approx(env.world.robot.footprint.radius_m)
