"""Recordings of the original simulators, and worlds to compare with them."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from diffstack_mmv.simulation import (
    CircleCrossing,
    CrowdNavVerdict,
    DiscFootprint,
    ExactVerdict,
    HolonomicRobot,
    OrcaCrowd,
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
        verdict = (ExactVerdict if exact else CrowdNavVerdict)(DiscFootprint(), limit_s)
        return World(robot or HolonomicRobot(), OrcaCrowd(), verdict, dt_s, visible)

    return build


@pytest.fixture
def scene_with():
    """One human at a given place that wants to go to a given goal, the robot at the origin."""

    def build(human, goal, robot_goal=(0.0, 8.0)):
        scene = CircleCrossing(humans=1).case("test", 0)
        place = torch.tensor([human], dtype=torch.float64)
        aim = torch.tensor([goal], dtype=torch.float64)
        humans = scene.humans._replace(position=place, goal=aim, velocity=torch.zeros_like(place))
        return scene._replace(
            robot_position=torch.zeros(2, dtype=torch.float64),
            robot_goal=torch.tensor(robot_goal, dtype=torch.float64),
            humans=humans,
        )

    return build
