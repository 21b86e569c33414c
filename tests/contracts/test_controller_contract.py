"""What every controller and every forecast of pedestrians promises, for all in `configs/`."""

from pathlib import Path

import pytest
import torch
from hydra.utils import instantiate

from diffstack_mmv.prediction import ConstantVelocity
from diffstack_mmv.simulation import (
    CircleCrossing,
    Controller,
    ExactVerdict,
    HolonomicRobot,
    OrcaCrowd,
    PedestrianForecaster,
    World,
)
from diffstack_mmv.simulation.study import is_massless
from diffstack_mmv.types import map_tensors
from diffstack_mmv.vehicles import config_folder
from tests.simulation.conftest import composed_navigate


def options(group):
    return sorted(path.stem for path in (Path(config_folder()) / group).glob("*.yaml"))


# `ppo` reads a trained policy, see tests/simulation/test_learned_policy.py
CONTROLLERS = [name for name in options("controller") if name != "ppo"]
# presets of one controller, which differ in settings: all of them in the slow tests
PRESETS = {"diffmpc_adaptive", "diffmpc_crowded", "diffmpc_delay", "diffmpc_tracking"}
DRIVERS = [
    pytest.param(name, marks=pytest.mark.slow if name in PRESETS else []) for name in CONTROLLERS
]
# `known` reads a recording, see tests/simulation/recorded
PEOPLE = [name for name in options("people") if name != "known"]
SETTINGS = {"predictor": {"predictor": ConstantVelocity(30, 0.1)}}  # in the place of a checkpoint


@pytest.fixture(scope="module", params=PEOPLE)
def forecaster(request):
    config = composed_navigate(f"people={request.param}")
    return instantiate(config.people, **SETTINGS.get(request.param, {}))


@pytest.fixture(scope="module", params=DRIVERS)
def setting(request):
    """A controller, and the world with the robot that it commands."""
    config = composed_navigate(f"controller={request.param}")
    # `diffmpc_ego` holds the controller that it tells its motion
    planning = config.controller.get("controller", config.controller)
    if "planner" in planning:
        planning.planner.solver.max_iterations = 3
        planning.planner.steps = 8
    if "estimator" in config.controller:
        config.controller.estimator.iterations = 2
    controller = instantiate(config.controller)
    robot = HolonomicRobot() if is_massless(type(controller)) else instantiate(config.robot)
    return controller, World(robot, OrcaCrowd(), ExactVerdict(10.0))


def walk(world, humans=5, cases=(0, 1), steps=2):
    """Observations of crowds that walk on their own."""
    state = world.start(CircleCrossing(humans=humans).cases("train", cases))
    seen = []
    for _ in range(steps):
        seen.append(world.observe(state))
        state = world.step(state, torch.zeros(len(cases), len(world.robot.bounds.lower))).state
    return seen


def equal(first, second):
    """Whether two nested records hold the same tensors."""
    same = []
    pairs = iter(tensors_of(second))
    map_tensors(lambda entry: same.append(torch.equal(entry, next(pairs))) or entry, first)
    return all(same)


def tensors_of(record):
    found = []
    map_tensors(lambda entry: found.append(entry) or entry, record)
    return found


@pytest.fixture(scope="module")
def crowd():
    return walk(World(HolonomicRobot(), OrcaCrowd(), ExactVerdict(10.0)))


@pytest.mark.parametrize(("dt_s", "steps"), [(0.25, 12), (0.1, 1), (0.5, 10)])
def test_a_forecast_is_a_proper_mixture_of_the_asked_horizon(forecaster, crowd, dt_s, steps):
    assert isinstance(forecaster, PedestrianForecaster)
    forecast, _ = forecaster(forecaster.init(crowd[0]), crowd[0], dt_s, steps)
    components = forecast.log_weight.shape[-1]
    assert forecast.mean.shape == (2, 5, components, steps, 2)
    assert forecast.scale_tril.shape == (2, 5, components, steps, 2, 2)
    assert torch.allclose(forecast.log_weight.exp().sum(-1), torch.ones(2, 5).double())
    here = crowd[0].pedestrian_position.unsqueeze(-2).expand(2, 5, steps, 2)
    assert torch.isfinite(forecast.log_prob(here)).all()


def test_a_forecast_remembers_by_its_state_alone(forecaster, crowd):
    state = forecaster.init(crowd[0])
    for seen in crowd:
        before = state
        first, state = forecaster(before, seen, 0.25, 4)
        again, _ = forecaster(before, seen, 0.25, 4)
        assert equal(first, again)


def test_an_action_is_finite_and_one_per_episode(setting):
    controller, world = setting
    assert isinstance(controller, Controller)
    with torch.no_grad():
        for humans, cases in ((1, (0,)), (5, (0, 1))):
            state = None
            for seen in walk(world, humans, cases):
                state = controller.init(seen) if state is None else state
                action, state = controller.act(state, seen)
                assert action.shape == (len(cases), len(world.robot.bounds.lower))
                assert torch.isfinite(action).all()


def test_a_controller_remembers_by_its_state_alone(setting):
    """Asked twice with the same state it answers the same: nothing is kept in the controller."""
    controller, world = setting
    seen = walk(world)
    state = controller.init(seen[0])
    with torch.no_grad():
        for each in seen:
            before = state
            first, state = controller.act(before, each)
            again, _ = controller.act(before, each)
            assert torch.equal(first, again)


def test_episodes_that_have_ended_change_nothing_for_the_others(setting):
    controller, world = setting
    seen = walk(world)[0]
    running = torch.tensor([True, False])
    with torch.no_grad():
        both = controller.act(controller.init(seen), seen).action
        one = controller.act(controller.init(seen), seen._replace(running=running)).action
    assert torch.allclose(both[0], one[0], atol=1e-4)


def test_a_single_episode_needs_no_leading_dimension(setting):
    controller, world = setting
    batch = walk(world, cases=(0,))[0]
    single = map_tensors(lambda entry: entry[0], batch)
    with torch.no_grad():
        action = controller.act(controller.init(single), single).action
        expected = controller.act(controller.init(batch), batch).action
    assert torch.allclose(action, expected[0], atol=1e-5)
