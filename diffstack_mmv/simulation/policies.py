"""The simplest controllers: baselines of the benchmark, and the shortest complete examples."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.geometry import rotate, unit_vector
from diffstack_mmv.simulation.decisions import Decided
from diffstack_mmv.simulation.observation import Observation
from diffstack_mmv.simulation.pedestrians import OrcaCrowd
from diffstack_mmv.simulation.pedestrians.base import towards
from diffstack_mmv.simulation.pedestrians.half_planes import Agents, Neighbors
from diffstack_mmv.types import Motion


class _Memoryless:
    """What controllers share that decide by the present observation alone."""

    def init(self, observation: Observation) -> None:
        """Nothing to remember."""
        return


@dataclass(frozen=True)
class StraightLine(_Memoryless):
    """Drives a holonomic robot straight to the goal, blind to the pedestrians.

    Attributes:
        speed_mps: Constant speed.

    Raises:
        ValueError: The speed is not positive.
    """

    massless: ClassVar[bool] = True
    speed_mps: float = 1.0

    def __post_init__(self) -> None:
        """Check the speed once, at the border."""
        require_positive("speed_mps", self.speed_mps)

    def act(self, state: None, observation: Observation) -> Decided:
        """Velocity in m/s."""
        way = observation.goal - observation.motion.position
        angle = torch.atan2(way[..., 1], way[..., 0])
        return Decided(unit_vector(angle) * self.speed_mps, None)


@dataclass(frozen=True)
class OrcaPolicy(_Memoryless):
    """Drives a holonomic robot by ORCA, as the original benchmark's ORCA robot does.

    Attributes:
        dt_s: Step of the simulation.
        speed_mps: Largest speed.
        orca: Its settings.

    Raises:
        ValueError: The step or the speed is not positive.
    """

    massless: ClassVar[bool] = True
    dt_s: float = 0.25
    speed_mps: float = 1.0
    orca: OrcaCrowd = field(default_factory=OrcaCrowd)

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_positive("dt_s", self.dt_s)
        require_positive("speed_mps", self.speed_mps)

    def act(self, state: None, observation: Observation) -> Decided:
        """Velocity in m/s."""
        position = observation.motion.position
        robot = Agents(
            position=position,
            velocity=observation.velocity,
            preferred_velocity=towards(position, observation.goal),
            radius=observation.radius,
            max_speed=torch.full_like(observation.radius, self.speed_mps),
        )
        radius = observation.pedestrian_radius
        pedestrians = Neighbors(
            position=observation.pedestrian_position,
            velocity=observation.pedestrian_velocity,
            radius=radius,
            valid=observation.seen,
        )
        return Decided(self.orca.velocity(robot, pedestrians, self.dt_s), None)


class BlindDriver(_Memoryless):
    """Drives a vehicle straight to the goal and stop there, blind to the pedestrians.

    Args:
        dynamics: Model of the vehicle, whose step is the time between two decisions.
        cruise_mps: Cruising speed.
        braking_mps2: Deceleration towards the goal.
        actuate: Turns controls of the model into those of the robot; None: they are the same.

    Raises:
        ValueError: A number is not positive.
    """

    def __init__(
        self,
        dynamics: DynamicsModel,
        cruise_mps: float = 3.0,
        braking_mps2: float = 2.8,
        actuate: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        require_positive("cruise_mps", cruise_mps)
        require_positive("braking_mps2", braking_mps2)
        self.dynamics = dynamics
        self.cruise_mps = cruise_mps
        self.braking_mps2 = braking_mps2
        self.actuate = actuate

    def act(self, state: None, observation: Observation) -> Decided:
        """Control of the robot in SI units."""
        like = self.dynamics.bounds.lower
        motion = Motion(*(field.to(like) for field in observation.motion))
        acceleration = self._acceleration(motion, observation)
        vehicle = self.dynamics.initial_state(motion)
        straight = torch.zeros_like(acceleration)
        action = self.dynamics.control_for(vehicle, acceleration, straight)
        return Decided(action if self.actuate is None else self.actuate(action), None)

    def _acceleration(self, motion: Motion, observation: Observation) -> Float[Tensor, "*b"]:
        """Acceleration in m/s² along the straight way to the goal."""
        way = (observation.goal.to(motion.position) - motion.position).square().sum(-1).sqrt()
        target = (2 * self.braking_mps2 * way).sqrt().clamp(max=self.cruise_mps)
        return (target - motion.velocity[..., 0]) / self.dynamics.dt_s


class StopAndGoDriver(BlindDriver):
    """Drives a vehicle straight to the goal, and stops for whoever is in its way or about to be.

    The way is a strip ahead as wide as the vehicle, as long as the way to a standstill and some
    more. Who walks on at the present velocity into it within `ahead_s`, stops the vehicle as well.

    Args:
        dynamics: Model of the vehicle, whose step is the time between two decisions.
        cruise_mps: Cruising speed.
        braking_mps2: Deceleration towards the goal and before pedestrians.
        margin_m: Clearance that is kept at the sides.
        ahead_m: Clearance that is kept ahead.
        ahead_s: How far the walks are continued.
        actuate: As that of `BlindDriver`.

    Raises:
        ValueError: A number is not positive.
    """

    def __init__(
        self,
        dynamics: DynamicsModel,
        cruise_mps: float = 3.0,
        braking_mps2: float = 2.8,
        margin_m: float = 0.3,
        ahead_m: float = 1.0,
        ahead_s: float = 2.0,
        actuate: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        super().__init__(dynamics, cruise_mps, braking_mps2, actuate)
        require_positive("margin_m", margin_m)
        require_positive("ahead_m", ahead_m)
        require_positive("ahead_s", ahead_s)
        self.margin_m = margin_m
        self.ahead_m = ahead_m
        self.ahead_s = ahead_s

    def _acceleration(self, motion: Motion, observation: Observation) -> Float[Tensor, "*b"]:
        """Acceleration in m/s² on the way to the goal, or to a standstill where that is blocked."""
        speed = motion.velocity[..., 0]
        braking = -(speed / self.dynamics.dt_s).clamp(max=self.braking_mps2)
        freely = super()._acceleration(motion, observation)
        return torch.where(self._blocked(observation), braking, freely)

    def _blocked(self, observation: Observation) -> Bool[Tensor, "*b"]:
        """Whether somebody is in the strip ahead, or will be."""
        speed = observation.motion.velocity[..., 0].clamp(min=0)
        stopping = speed.square() / (2 * self.braking_mps2) + speed * self.dynamics.dt_s
        steps = round(self.ahead_s / self.dynamics.dt_s) + 1
        time = self.dynamics.dt_s * torch.arange(steps).to(speed)
        walk = observation.pedestrian_velocity[..., None, :] * time[:, None]
        offset = observation.pedestrian_position[..., None, :] + walk
        offset = offset - observation.motion.position[..., None, None, :]
        local = rotate(offset, -observation.motion.heading[..., None, None])
        apart = observation.pedestrian_radius + observation.radius[..., None] + self.margin_m
        beside = local[..., 1].abs() < apart[..., None]
        ahead = (local[..., 0] > -observation.radius[..., None, None]) & (
            local[..., 0] < (stopping + self.ahead_m)[..., None, None] + apart[..., None]
        )
        within = beside & ahead & observation.seen[..., None]
        return within.flatten(-2).any(-1)
