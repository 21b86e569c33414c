"""A study of closed-loop driving: a controller and its baselines, each in the world it needs."""

from dataclasses import replace
from typing import Any

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.simulation.assembly import SimulatedVehicle
from diffstack_mmv.simulation.observation import Sensing
from diffstack_mmv.simulation.pedestrians import Crowd
from diffstack_mmv.simulation.robot import HolonomicRobot
from diffstack_mmv.simulation.vehicle_robot import VehicleRobot
from diffstack_mmv.simulation.verdicts import verdict_named
from diffstack_mmv.simulation.world import World


def study_world(
    robot: VehicleRobot,
    crowd: Crowd,
    verdict: str,
    limit_s: float,
    dt_s: float,
    robot_visible: bool = False,
    reveals_s: float = 0.0,
    sensing: Sensing | None = None,
) -> World:
    """The world of a study.

    Args:
        robot: The vehicle.
        crowd: How the pedestrians choose their velocities.
        verdict: "crowdnav" or "exact".
        limit_s: Time limit of an episode.
        dt_s: Length of a step.
        robot_visible: Whether the pedestrians avoid the robot; those of a reactive crowd always do.
        reveals_s: How far the observations tell what is recorded to come.
        sensing: What the robot sees of the pedestrians; everything if None.

    Returns:
        The world.

    Raises:
        ValueError: There is no such verdict, or the times do not fit.
    """
    visible = robot_visible or bool(getattr(crowd, "reactive", False))
    judge = verdict_named(verdict, limit_s)
    return World(robot, crowd, judge, dt_s, visible, reveals_s, sensing)


def world_for(world: World, controller: type) -> World:
    """The world in which a controller drives: massless ones drive the original benchmark's robot.

    Args:
        world: The world of the vehicle.
        controller: Class of the controller.

    Returns:
        The same world, or the one with the massless robot, which is always a disc.
    """
    return replace(world, robot=HolonomicRobot()) if is_massless(controller) else world


def is_massless(controller: type) -> bool:
    """Whether controllers of this class drive the massless robot, see `Controller`."""
    return bool(getattr(controller, "massless", False))


def models_told(
    actual: SimulatedVehicle,
    believed: SimulatedVehicle,
    world: World,
    model: DynamicsModel,
) -> dict[str, Any]:
    """Which models drove and planned, for a results file.

    Args:
        actual: The vehicle that drives.
        believed: The one that the controller believes in.
        world: Where the controller drives, with the robot built from the first; a massless
            controller has another, which is all that is told.
        model: The model of the controller, built from the second.

    Returns:
        Names of both dynamics, and what their models are, with the outline that both are given.
    """
    robot = world.robot
    outline = {"footprint": robot.footprint.description()}
    drives = robot.description(world.dt_s) | outline | {"controls": list(robot.control_names)}
    if not isinstance(robot, VehicleRobot):
        return {
            "dynamics": "massless",
            "believed_dynamics": "massless",
            "footprint": "disc",  # whatever the configuration gives the vehicle
            "actual_model": drives,
            "believed_model": drives,
        }
    thinks = model.description() | outline | {"controls": list(model.Control._fields)}
    return {
        "dynamics": actual.dynamics_name,
        "believed_dynamics": believed.dynamics_name,
        "actual_model": drives,
        "believed_model": thinks,
    }
