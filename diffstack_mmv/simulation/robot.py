"""Robots that drive through the crowd: what an action does to them."""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.geometry import rotate, unit_vector
from diffstack_mmv.simulation.collision import DiscFootprint, Footprint
from diffstack_mmv.simulation.pedestrians import VisibleRobot
from diffstack_mmv.simulation.scene import Scene
from diffstack_mmv.simulation.verdict import RobotPath
from diffstack_mmv.types import Bounds, Motion


class Travel(NamedTuple):
    """One step of a robot."""

    state: Any  # the robot's own record
    velocity: Float[Tensor, "*b 2"]  # m/s, world: constant over the step, it leads to the same end
    path: RobotPath


@runtime_checkable
class Robot(Protocol):
    """A robot; its state is a record of its own, `*b`, which only the robot itself reads."""

    @property
    def bounds(self) -> Bounds:
        """Box of the actions, (m,)."""
        ...

    @property
    def footprint(self) -> Footprint:
        """Outline around the reference point, the centre of its motion."""
        ...

    @property
    def control_names(self) -> tuple[str, ...]:
        """Names of the columns of an action."""
        ...

    def description(self, dt_s: float) -> dict[str, Any]:
        """What a results file tells of its dynamics, in steps of `dt_s`."""
        ...

    def start(self, scene: Scene) -> Any:
        """State at rest at the start of a scene."""
        ...

    def step(self, state: Any, action: Float[Tensor, "*b m"], dt_s: float) -> Travel:
        """Apply an action for `dt_s`."""
        ...

    def motion(self, state: Any) -> Motion:
        """Motion of the robot's centre in m, rad, m/s."""
        ...

    def velocity(self, state: Any) -> Float[Tensor, "*b 2"]:
        """Velocity in m/s in world directions, as pedestrians see it."""
        ...


def seen_by_pedestrians(robot: Robot, state: Any) -> VisibleRobot:
    """The robot in the eyes of pedestrians: the disc around its reference point that holds it."""
    position = robot.motion(state).position
    radius = position.new_tensor(robot.footprint.radius_m).expand(position.shape[:-1])
    return VisibleRobot(position, robot.velocity(state), radius)


class PointState(NamedTuple):
    """A point with a heading; the velocity is in world directions."""

    position: Float[Tensor, "*b 2"]  # m
    velocity: Float[Tensor, "*b 2"]  # m/s
    heading: Float[Tensor, "*b"]  # rad


class _PointRobot:
    """What the massless robots of the benchmark share, its disc as footprint included.

    Args:
        max_speed_mps: Largest entry of an action in m/s, stated by `bounds` and not enforced.

    Raises:
        ValueError: The speed is not positive.
    """

    def __init__(self, max_speed_mps: float = 1.0) -> None:
        require_positive("max_speed_mps", max_speed_mps)
        self.max_speed_mps = max_speed_mps
        self.footprint: Footprint = DiscFootprint()

    def description(self, dt_s: float) -> dict[str, Any]:
        """The class; there is nothing else to tell."""
        return {"class": type(self).__name__, "tyre_law": None, "step_s": dt_s, "substeps": 1}

    def start(self, scene: Scene) -> PointState:
        """State at rest at the start of a scene, m and rad."""
        position = scene.robot_position
        return PointState(position, torch.zeros_like(position), scene.robot_heading)

    def motion(self, state: PointState) -> Motion:
        """Motion of the point in m, rad, m/s; it turns between steps only, its yaw rate is zero."""
        return Motion(
            position=state.position,
            heading=state.heading,
            velocity=rotate(state.velocity, -state.heading),
            yaw_rate=torch.zeros_like(state.heading),
        )

    def velocity(self, state: PointState) -> Float[Tensor, "*b 2"]:
        """Velocity in m/s in world directions."""
        return state.velocity


class HolonomicRobot(_PointRobot):
    """The benchmark's robot: an action is a velocity (v_x, v_y) in m/s, which it takes at once.

    Args:
        max_speed_mps: Largest entry of an action in m/s, stated by `bounds` and not enforced.

    Raises:
        ValueError: The speed is not positive.
    """

    control_names = ("velocity_x", "velocity_y")

    @property
    def bounds(self) -> Bounds:
        """Velocities in m/s."""
        upper = torch.full((2,), self.max_speed_mps, dtype=torch.float64)
        return Bounds(-upper, upper)

    def step(self, state: PointState, action: Float[Tensor, "*b 2"], dt_s: float) -> Travel:
        """p⁺ = p + v dt in m; the heading stays."""
        position = state.position + action * dt_s
        return _straight(state, PointState(position, action, state.heading), action)


class UnicycleRobot(_PointRobot):
    """The benchmark's unicycle: an action (v, r) turns it by r rad at once, then drives at v m/s.

    Args:
        max_speed_mps: Largest speed in m/s, stated by `bounds` and not enforced.

    Raises:
        ValueError: The speed is not positive.
    """

    control_names = ("speed", "turn")

    @property
    def bounds(self) -> Bounds:
        """Speed in m/s, turn in rad."""
        upper = torch.tensor((self.max_speed_mps, torch.pi), dtype=torch.float64)
        return Bounds(torch.tensor((0.0, -torch.pi), dtype=torch.float64), upper)

    def step(self, state: PointState, action: Float[Tensor, "*b 2"], dt_s: float) -> Travel:
        """θ⁺ = θ + r, p⁺ = p + v (cos θ⁺, sin θ⁺) dt in m, θ⁺ kept in [0, 2π)."""
        heading = state.heading + action[..., 1]
        velocity = unit_vector(heading) * action[..., :1]
        position = state.position + velocity * dt_s
        heading = torch.remainder(heading, 2 * torch.pi)
        return _straight(state, PointState(position, velocity, heading), velocity)


def _straight(before: PointState, after: PointState, velocity: Float[Tensor, "*b 2"]) -> Travel:
    """A step without a bend, at constant velocity in m/s."""
    path = RobotPath(
        position=torch.stack((before.position, after.position), dim=-2),
        heading=torch.stack((after.heading, after.heading), dim=-1),
    )
    return Travel(after, velocity, path)
