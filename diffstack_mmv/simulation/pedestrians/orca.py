"""Pedestrians that avoid each other by ORCA, as those of the CrowdNav benchmark do."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.simulation.pedestrians.base import CrowdState, VisibleRobot, towards
from diffstack_mmv.simulation.pedestrians.half_planes import (
    Agents,
    HalfPlanes,
    Neighbors,
    half_planes,
    nearest,
)
from diffstack_mmv.simulation.pedestrians.linear_program import safest_velocity
from diffstack_mmv.simulation.pedestrians.orca_library import Rules, is_possible, respond, roll


@dataclass(frozen=True)
class OrcaCrowd:
    """Optimal reciprocal collision avoidance, vectorised over episodes x pedestrians.

    Computes in float32 with the rounding of the RVO2 library and reproduces it bit for bit, in a
    library of its own (`orca_library`) where there is a compiler and in tensors elsewhere. The
    velocities carry no gradient.

    Attributes:
        neighbor_distance_m: Nobody further away is considered.
        max_neighbors: Only the nearest ones are considered.
        time_horizon_s: Time for which the chosen velocities are free of collision.
        margin_m: Added to every radius.

    Raises:
        ValueError: A distance or time is not positive, or the margin negative.

    Source:
        van den Berg et al., Reciprocal n-Body Collision Avoidance; the settings are those that
        Chen et al., Crowd-Robot Interaction, pass to it.
    """

    neighbor_distance_m: float = 10.0
    max_neighbors: int = 10
    time_horizon_s: float = 5.0
    margin_m: float = 0.01

    def __post_init__(self) -> None:
        """Check the settings once, at the border."""
        require_positive("neighbor_distance_m", self.neighbor_distance_m)
        require_at_least("max_neighbors", self.max_neighbors, 1)
        require_positive("time_horizon_s", self.time_horizon_s)
        require_at_least("margin_m", self.margin_m, 0)

    def __call__(
        self, crowd: CrowdState, dt_s: float, robot: VisibleRobot | None = None
    ) -> Float[Tensor, "*b h 2"]:
        """Velocities of all pedestrians for the next step.

        Args:
            crowd: The pedestrians of all episodes.
            dt_s: Length of the step in s.
            robot: The robot, where the pedestrians see it.

        Returns:
            Velocities in m/s in the precision of the positions; every value is a float32 number.
        """
        if crowd.radius.shape[-1] == 0:
            return crowd.velocity
        if is_possible(crowd, robot):
            rolled = roll(crowd, self._rules(dt_s), self.margin_m, dt_s, 1, robot)
            return rolled.velocity.squeeze(-2)
        agents = _as_agents(crowd, towards(crowd.position, crowd.goal))
        return self.velocity(agents, _everybody_else(crowd, robot), dt_s)

    def positions(self, crowd: CrowdState, dt_s: float, steps: int) -> Float[Tensor, "*b h T 2"]:
        """Where all pedestrians are after 1 .. `steps` steps with nobody else around.

        Args:
            crowd: The pedestrians of all episodes.
            dt_s: Length of a step in s.
            steps: Number of steps T, at least one.

        Returns:
            Positions in m.
        """
        if crowd.radius.shape[-1] and is_possible(crowd):
            return roll(crowd, self._rules(dt_s), self.margin_m, dt_s, steps).position
        positions = []
        for _ in range(steps):
            crowd = crowd.moved(self(crowd, dt_s), dt_s)
            positions.append(crowd.position)
        return torch.stack(positions, dim=-2)

    @torch.no_grad()
    def responses(
        self, crowd: CrowdState, goals: Float[Tensor, "*b h k 2"], dt_s: float
    ) -> Float[Tensor, "*b h k 2"]:
        """What each pedestrian would do if it had another goal and all else were as it is.

        Args:
            crowd: The pedestrians of all episodes, whose own goals do not matter.
            goals: Goals in m to try for each pedestrian.
            dt_s: Length of the step in s.

        Returns:
            Velocities in m/s, one per goal.
        """
        if crowd.radius.shape[-1] == 0:
            return goals
        if is_possible(crowd, goals=goals):
            return respond(crowd, self._rules(dt_s), self.margin_m, goals)
        agents = _as_agents(crowd, towards(crowd.position.unsqueeze(-2), goals))
        preferred = agents.preferred_velocity.float()
        planes = self._planes(agents, _everybody_else(crowd, None), dt_s)
        shape = (*goals.shape[:-1], planes.valid.shape[-1])
        many = HalfPlanes(
            planes.point.unsqueeze(-3).expand(*shape, 2),
            planes.direction.unsqueeze(-3).expand(*shape, 2),
            planes.valid.unsqueeze(-2).expand(shape),
        )
        speed = agents.max_speed.float().unsqueeze(-1).expand(goals.shape[:-1])
        return safest_velocity(many, speed, preferred).to(goals.dtype)

    @torch.no_grad()
    def velocity(self, agents: Agents, neighbors: Neighbors, dt_s: float) -> Float[Tensor, "*b 2"]:
        """Velocity of any agents among any neighbors: also a robot may drive by ORCA.

        Args:
            agents: Agents, `*b`; radii in m without the margin.
            neighbors: What each of them sees, `*b k`, radii in m without the margin.
            dt_s: Length of the step in s.

        Returns:
            Velocities in m/s in the precision of the positions.
        """
        planes = self._planes(agents, neighbors, dt_s)
        chosen = safest_velocity(
            planes, agents.max_speed.float(), agents.preferred_velocity.float()
        )
        return chosen.to(agents.position.dtype)

    def _rules(self, dt_s: float) -> Rules:
        """The settings for a step of `dt_s`."""
        return Rules(self.neighbor_distance_m, self.time_horizon_s, dt_s, self.max_neighbors)

    def _planes(self, agents: Agents, neighbors: Neighbors, dt_s: float) -> HalfPlanes:
        """Half-planes of the nearest neighbors, in float32."""
        wide = agents._replace(radius=agents.radius + self.margin_m)
        wide = Agents(*(field.float() for field in wide))
        seen = Neighbors(
            position=neighbors.position.float(),
            velocity=neighbors.velocity.float(),
            radius=(neighbors.radius + self.margin_m).float(),
            valid=neighbors.valid,
        )
        constant = wide.radius.new_tensor
        count = torch.tensor(self.max_neighbors, device=wide.radius.device)
        seen = nearest(wide, seen, constant(self.neighbor_distance_m), count).neighbors
        return half_planes(wide, seen, constant(dt_s), constant(self.time_horizon_s))


def _as_agents(crowd: CrowdState, preferred: Float[Tensor, "..."]) -> Agents:
    """The pedestrians with these preferred velocities (m/s)."""
    return Agents(
        position=crowd.position,
        velocity=crowd.velocity,
        preferred_velocity=preferred,
        radius=crowd.radius,
        max_speed=crowd.preferred_speed,
    )


def _everybody_else(crowd: CrowdState, robot: VisibleRobot | None) -> Neighbors:
    """For each pedestrian the other ones in order of their index, then the robot."""
    pedestrians = crowd.radius.shape[-1]
    index = torch.arange(pedestrians - 1, device=crowd.radius.device).expand(
        pedestrians, pedestrians - 1
    )
    index = index + (index >= torch.arange(pedestrians, device=index.device)[:, None])
    position = crowd.position[..., index, :]
    velocity = crowd.velocity[..., index, :]
    radius = crowd.radius[..., index]
    if robot is not None:
        shape = radius.shape[:-1]
        position = torch.cat((position, _for_all(robot.position, (*shape, 1, 2))), dim=-2)
        velocity = torch.cat((velocity, _for_all(robot.velocity, (*shape, 1, 2))), dim=-2)
        radius = torch.cat((radius, robot.radius[..., None, None].expand(*shape, 1)), dim=-1)
    return Neighbors(position, velocity, radius, torch.ones_like(radius, dtype=torch.bool))


def _for_all(vector: Float[Tensor, "*b 2"], shape: tuple[int, ...]) -> Float[Tensor, "..."]:
    """Show one vector per episode to every pedestrian of it."""
    return vector[..., None, None, :].expand(shape)
