"""CrowdNav from Python drives as the command line does."""

import copy
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate

import diffstack_mmv.commands.cli  # noqa: F401  registers the resolvers
from diffstack_mmv.crowdnav import LIMITS, CrowdNav
from diffstack_mmv.crowdnav import drive as of_a_drive
from diffstack_mmv.simulation import DiffMPCController, drive
from diffstack_mmv.vehicles import config_folder, load_vehicle, save_vehicle
from dmmv_conventions.config_files import names_in

CONTROLLERS = config_folder() / "controller"
EGO = {"controller": "diffmpc_ego"}
OTHER = {
    "vehicle": "scooter", "dynamics": "gm3", "scenario": "square_crossing", "footprint": "vehicle",
    "people": "constant_velocity", "controller": "diffmpc_crowded",
}  # fmt: skip


def composed(choices, limit_s):
    """World, controller and scenario of the command line."""
    given = [*(f"{group}={name}" for group, name in choices.items()), f"limit_s={limit_s}"]
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("navigate", [*given, "wandb=none"], return_hydra_config=True)
        HydraConfig.instance().set_config(config)
    return tuple(instantiate(config[part]) for part in ("world", "controller", "scenario"))


@pytest.mark.parametrize(
    "choices",
    [
        {"controller": "mppi"},
        *(pytest.param(each, marks=pytest.mark.slow) for each in ({}, EGO, OTHER)),
    ],
    ids=["mppi", "as configured", "estimating", "all others"],
)
def test_episodes_are_those_of_the_command_line(choices):
    own = CrowdNav(**choices, limit_s=0.25)
    world, controller, scenario = composed(choices, 0.25)
    expected = drive(world, scenario.cases("test", [3]), controller).record
    found = drive(own.world(), own.cases().cases("test", [3]), own.driver()).record
    assert torch.equal(found.controls, expected.controls)
    assert torch.equal(found.motion.position, expected.motion.position)
    assert torch.equal(found.clearance, expected.clearance)


def test_a_disturbed_robot_is_that_of_the_command_line():
    disturbed = {"delay_s": 0.15, "noise": (0.2, 0.05), "sensing": "within_5m", "seed": 3}
    choices = {
        "robot.delay_s": 0.15, "robot.noise": "[0.2,0.05]", "sensing": "within_5m", "seed": 3,
    }  # fmt: skip
    own = CrowdNav(controller="diffmpc_delay", **disturbed)
    world, controller, _ = composed({"controller": "diffmpc_delay", **choices}, 0.25)
    assert own.world().robot.actuation == world.robot.actuation
    assert own.world().sensing == world.sensing
    assert own.driver().delay.model.dt_s == controller.delay.model.dt_s


@pytest.mark.parametrize("name", sorted(set(names_in(CONTROLLERS)) - {"ppo"}))
def test_every_controller_without_files_of_its_own_is_that_of_the_command_line(name):
    own = CrowdNav(controller=name, delay_s=0.15).driver()
    _, expected, _ = composed({"controller": name}, 0.25)
    assert type(own) is type(expected)
    if isinstance(own, DiffMPCController):
        assert type(own.forecaster) is type(expected.forecaster)
        assert own.planner.cost.weights().keys() == expected.planner.cost.weights().keys()
        assert own.planner.solver == expected.planner.solver


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"controller": "ppo"}, "`controller` must need nothing that the command line alone knows"),
        ({"controller": "ppo"}, "but got ppo, which needs policy"),
        ({"people": "predictor"}, "but got predictor, which needs people_checkpoint"),
        ({"scenario": "replay"}, "`scenario` must describe one part, but got replay"),
        ({"crowd": "replay"}, "`crowd` must describe one part, but got replay"),
    ],
)
def test_what_the_command_line_alone_can_build_is_told(given, told):
    with pytest.raises(ValueError, match="Use the command line, dmmv-navigate") as raised:
        CrowdNav(**given)
    assert told in str(raised.value)


def test_cases_are_driven_and_kept(tmp_path):
    study = CrowdNav(load_vehicle("bicycle"), controller="straight", limit_s=1.0)
    result = study.drive(range(2), folder=tmp_path)
    assert result["n"] == 2
    assert result["success_rate"] + result["collision_rate"] + result["incomplete_rate"] == 1
    assert study.drive(range(2), folder=tmp_path)["cases"] == result["cases"]
    assert math.isfinite(study.drive([0])["mean_episode_min_dist_m"])


def _of_another_vehicle(monkeypatch, file):
    slower = replace(load_vehicle(file).limits, speed_max_mps=1.0)
    save_vehicle(replace(load_vehicle(file), limits=slower), file)


def _of_another_file(monkeypatch, file):
    monkeypatch.setattr(of_a_drive, "settings_of", lambda name, folder: {"changed": True})


def _of_another_code(monkeypatch, file):
    monkeypatch.setattr(of_a_drive, "code_version", lambda: "another")


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (_of_another_vehicle, "same settings .vehicle.limits: .'speed_max_mps': 1.0"),
        (_of_another_file, "same settings .constraints none: .'changed': True"),
        (_of_another_code, "same code .another"),
    ],
)
def test_kept_episodes_are_those_of_the_same_files_and_code(monkeypatch, tmp_path, changed, told):
    file, folder = tmp_path / "mine.yaml", tmp_path / "episodes"
    save_vehicle(load_vehicle("bicycle"), file)
    study = CrowdNav(file, controller="blind", limit_s=0.5)
    study.drive([0], folder=folder)
    study.drive([0], folder=folder)
    changed(monkeypatch, file)
    with pytest.raises(ValueError, match=told):
        study.drive([0], folder=folder)


@pytest.mark.parametrize(
    "cases",
    [np.arange(2), torch.arange(2), (case for case in (0, 1))],
    ids=["array", "tensor", "generator"],
)
def test_cases_are_any_whole_numbers(cases):
    assert CrowdNav(controller="straight", limit_s=0.25).drive(cases)["n"] == 2


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"controller": "diffmcp"}, "`controller` must be one of blind, diffmpc"),
        ({"dynamics": "magic"}, "`dynamics` must be one of gm3"),
        ({"controller": "diffmpc_delay"}, "`delay_s` must be positive, but got 0.0"),
        ({"sensing": "ears"}, "`sensing` must be one of everything, within_5m"),
        ({"seed": "one"}, "`seed` must be a whole number, but got 'one'"),
        ({"dynamics": None}, "`dynamics` must be one of gm3"),
        ({"vehicle": "bike"}, "`vehicle` must be one of autobike, bicycle"),
        ({"limits": {"speed_max_mps": 2.0}}, "`limits` must hold speed_max_mps, acceleration_min_"),
        ({"limits": {**LIMITS, "jerk": 1.0}}, "Give these three and no other."),
        (
            {"limits": {**LIMITS, "speed_max_mps": "fast"}},
            "`limits.speed_max_mps` must be a finite number, but got 'fast'",
        ),
        ({"limits": {**LIMITS, "speed_max_mps": math.nan}}, "be a finite number, but got nan"),
        ({"limits": {**LIMITS, "speed_max_mps": True}}, "be a finite number, but got True"),
        ({"limits": {**LIMITS, "speed_max_mps": 0.0}}, "`limits.speed_max_mps` must be positive"),
    ],
)
def test_settings_of_nothing_are_refused(given, told):
    with pytest.raises(ValueError, match="`") as raised:
        CrowdNav(**given)
    assert told in str(raised.value)


@pytest.mark.usefixtures("unchecked")
def test_an_error_of_the_controls_that_is_no_list_is_refused():
    with pytest.raises(ValueError, match="`noise` must be a list, with a number for each control"):
        CrowdNav(controller="blind", noise=0.1).world()


@pytest.mark.parametrize("again", [copy.deepcopy, lambda study: pickle.loads(pickle.dumps(study))])
def test_a_study_goes_to_other_processes(again):
    study = CrowdNav("scooter", limit_s=5.0)
    assert again(study) == study


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("cases", "told"),
    [
        (3, "`cases` must be a list or a range of numbers, but got 3. Write range(3) for the fir"),
        ("12", "`cases` must be a list or a range of numbers, but got '12'"),
        ([3, 4, 3], "`cases` must name each case once, but got 3 more than once"),
        (np.array(3), "`cases` must be a list or a range of numbers, but got array(3)"),
        ([0, 1.5], "`cases[1]` must be a whole number, but got 1.5"),
        ([], "`cases` must name at least one case"),
    ],
)
def test_cases_that_cannot_be_counted_are_refused(cases, told):
    with pytest.raises(ValueError, match="`cases") as raised:
        CrowdNav(controller="straight").drive(cases)
    assert told in str(raised.value)


def test_names_are_checked_before_anything_is_built():
    with pytest.raises(ValueError, match="`crowd` must be one of"):
        CrowdNav(crowd="tourists")
