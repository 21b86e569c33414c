"""Closed-loop simulation: scenarios, pedestrians, robots, verdicts and the environment."""

from diffstack_mmv.simulation.assembly import (
    Driven,
    actuation,
    controller_model,
    require_stoppable,
    vehicle_robot,
)
from diffstack_mmv.simulation.benchmark import Chunk, Method, read_chunk, run
from diffstack_mmv.simulation.collision import DiscFootprint, Footprint, RectangleFootprint
from diffstack_mmv.simulation.controller import DiffMPCController
from diffstack_mmv.simulation.env import ENV_ID, VERDICTS, CrowdNavEnv, register, robot_named
from diffstack_mmv.simulation.episode import drive
from diffstack_mmv.simulation.forecasters import (
    ConstantVelocityForecaster,
    OrcaForecaster,
    PedestrianForecast,
    PedestrianForecaster,
)
from diffstack_mmv.simulation.held import HeldControl
from diffstack_mmv.simulation.learned_forecaster import LearnedForecaster
from diffstack_mmv.simulation.learning import imitation_loss, way_left_loss
from diffstack_mmv.simulation.mppi import MPPIController
from diffstack_mmv.simulation.pedestrians import OrcaCrowd, SocialForceCrowd
from diffstack_mmv.simulation.policies import (
    BlindDriver,
    Controller,
    Decided,
    OrcaPolicy,
    StraightLine,
)
from diffstack_mmv.simulation.robot import HolonomicRobot, Robot, UnicycleRobot
from diffstack_mmv.simulation.scenario import CircleCrossing, Scenario, Scene, SquareCrossing
from diffstack_mmv.simulation.summary import summarise
from diffstack_mmv.simulation.vehicle_robot import Actuation, VehicleRobot
from diffstack_mmv.simulation.verdict import CrowdNavVerdict, ExactVerdict, Rewards, Verdict
from diffstack_mmv.simulation.world import Observation, World, WorldState

__all__ = [
    "ENV_ID",
    "VERDICTS",
    "Actuation",
    "BlindDriver",
    "Chunk",
    "CircleCrossing",
    "ConstantVelocityForecaster",
    "Controller",
    "Decided",
    "CrowdNavEnv",
    "CrowdNavVerdict",
    "DiffMPCController",
    "DiscFootprint",
    "Driven",
    "ExactVerdict",
    "Footprint",
    "HeldControl",
    "HolonomicRobot",
    "MPPIController",
    "Method",
    "Observation",
    "OrcaCrowd",
    "OrcaForecaster",
    "OrcaPolicy",
    "PedestrianForecast",
    "PedestrianForecaster",
    "LearnedForecaster",
    "RectangleFootprint",
    "Rewards",
    "Robot",
    "Scenario",
    "Scene",
    "SocialForceCrowd",
    "SquareCrossing",
    "StraightLine",
    "UnicycleRobot",
    "VehicleRobot",
    "Verdict",
    "World",
    "WorldState",
    "actuation",
    "controller_model",
    "drive",
    "imitation_loss",
    "read_chunk",
    "register",
    "require_stoppable",
    "robot_named",
    "run",
    "summarise",
    "vehicle_robot",
    "way_left_loss",
]

register()
