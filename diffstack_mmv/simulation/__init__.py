"""Closed-loop simulation: scenarios, pedestrians, robots, verdicts and the environment."""

from diffstack_mmv.simulation.collision import DiscFootprint, Footprint, RectangleFootprint
from diffstack_mmv.simulation.env import ENV_ID, CrowdNavEnv, register, robot_named
from diffstack_mmv.simulation.episode import drive
from diffstack_mmv.simulation.pedestrians import OrcaCrowd, SocialForceCrowd
from diffstack_mmv.simulation.policies import Controller, OrcaPolicy, StraightLine
from diffstack_mmv.simulation.robot import HolonomicRobot, Robot, UnicycleRobot
from diffstack_mmv.simulation.scenario import CircleCrossing, Scenario, Scene, SquareCrossing
from diffstack_mmv.simulation.vehicle_robot import Actuation, VehicleRobot
from diffstack_mmv.simulation.verdict import CrowdNavVerdict, ExactVerdict, Rewards, Verdict
from diffstack_mmv.simulation.world import Observation, World, WorldState

__all__ = [
    "ENV_ID",
    "Actuation",
    "CircleCrossing",
    "Controller",
    "CrowdNavEnv",
    "CrowdNavVerdict",
    "DiscFootprint",
    "ExactVerdict",
    "Footprint",
    "HolonomicRobot",
    "Observation",
    "OrcaCrowd",
    "OrcaPolicy",
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
    "drive",
    "register",
    "robot_named",
]

register()
