"""Recordings of the original simulators, and worlds to compare with them."""

import importlib.util
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import OmegaConf

import diffstack_mmv.commands.cli  # noqa: F401  registers the resolvers
from diffstack_mmv.simulation import (
    CircleCrossing,
    CrowdNavVerdict,
    ExactVerdict,
    HolonomicRobot,
    OrcaCrowd,
    SimulatedVehicle,
    SquareCrossing,
    World,
)

SCENARIOS = {"circle": CircleCrossing, "square": SquareCrossing}


@pytest.fixture(scope="session")
def recording(shared) -> Callable[[str], dict[str, np.ndarray]]:
    """Load one file of the reference data."""

    def load(name):
        with np.load(shared / "reference" / "crowdnav" / f"{name}.npz") as archive:
            return {key: archive[key] for key in archive}

    return load


@pytest.fixture
def scenario_of():
    """The scenario that a recording's name tells."""
    return lambda name, **settings: SCENARIOS[name.split("_")[0]](**settings)


@pytest.fixture
def world_with():
    """Build a world: the benchmark's, unless told otherwise."""

    def build(robot=None, exact=False, limit_s=25.0, dt_s=0.25, visible=False):
        verdict = (ExactVerdict if exact else CrowdNavVerdict)(limit_s)
        return World(robot or HolonomicRobot(), OrcaCrowd(), verdict, dt_s, visible)

    return build


@pytest.fixture
def scene_with():
    """One pedestrian at a given place that wants to go to a given goal, the robot at the origin."""

    def build(pedestrian, goal, robot_goal=(0.0, 8.0)):
        scene = CircleCrossing(humans=1).case("test", 0)
        place = torch.tensor([pedestrian], dtype=torch.float64)
        aim = torch.tensor([goal], dtype=torch.float64)
        pedestrians = scene.pedestrians._replace(
            position=place, goal=aim, velocity=torch.zeros_like(place)
        )
        return scene._replace(
            robot_position=torch.zeros(2, dtype=torch.float64),
            robot_goal=torch.tensor(robot_goal, dtype=torch.float64),
            pedestrians=pedestrians,
        )

    return build


@pytest.fixture
def observed(world_with):
    """What is seen of a crowd as it walks on its own, step by step."""

    def walk(scene, steps, dt_s=0.25):
        world = world_with(dt_s=dt_s)
        state = world.start(scene)
        seen = [world.observe(state)]
        for _ in range(steps):
            state = world.step(state, torch.zeros_like(scene.robot_position)).state
            seen.append(world.observe(state))
        return seen

    return walk


LIMITS = {"speed_max_mps": 3.0, "acceleration_min_mps2": -3.0, "acceleration_max_mps2": 2.0}


@pytest.fixture
def driven(root):
    """A vehicle of the catalogue under the limits of the benchmark."""

    def build(vehicle="bicycle", dynamics="kbm", **altered):
        mapping = yaml.safe_load((root / "configs" / "vehicle" / f"{vehicle}.yaml").read_text())
        return SimulatedVehicle(mapping, dynamics, LIMITS, **altered)

    return build


@pytest.fixture
def controller_for(driven):
    """The controller of the benchmark for a vehicle, with the settings of the configuration."""

    def build(vehicle="bicycle", dynamics="kbm", starts=1):
        overrides = [f"vehicle={vehicle}", f"dynamics={dynamics}"]
        starts = f"controller.planner.starts={starts}"
        return instantiate(composed_navigate(*overrides, starts).controller)

    return build


def composed_navigate(*overrides):
    """The configuration of the benchmark, eager unless told: libraries would take minutes.

    Interpolations are left to who builds a part of it: all of them take as long as the rest.
    """
    folder = Path(__file__).resolve().parents[2] / "configs"
    if not any(told.startswith("compile=") for told in overrides):
        overrides = (*overrides, "compile=false")
    with initialize_config_dir(str(folder), version_base="1.3"):
        config = compose("navigate", list(overrides), return_hydra_config=True)
        HydraConfig.instance().set_config(config)
        OmegaConf.set_struct(config, False)
        config.pop("hydra")
    return config


@pytest.fixture
def social_force_library():
    """Skip where the library is missing; it is not imported, which would leave a file behind."""
    if importlib.util.find_spec("pysocialforce") is None:
        pytest.skip("needs the extra `crowd`")
