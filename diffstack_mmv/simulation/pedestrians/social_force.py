"""Pedestrians that push each other away: the extended social force model of PySocialForce."""

import importlib
import logging
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.simulation.pedestrians.base import CrowdState, VisibleRobot
from dmmv_conventions.extras import needs

PACKAGE = "pysocialforce"
LEFT_BEHIND = "file.log"
"""Empty log that the library leaves in the working folder when it is imported."""

ASIDE_M = 1e-6
"""By how much somebody who stands exactly in the place of another is taken to stand aside."""


class _Agents(NamedTuple):
    """All agents of one episode as the library wants them, the robot last."""

    state: np.ndarray  # (a, 6): position, velocity, goal
    speed: np.ndarray  # (a,) preferred speed, m/s


@dataclass(frozen=True)
class SocialForceCrowd:
    """The social forces of the library `pysocialforce`, integrated over the step.

    The library handles one scene at a time, hence the episodes are looped over here. Its agents
    have no radius of their own and are points with the library's range of repulsion.

    Attributes:
        max_step_s: A step is cut into pieces no longer than this.
        speed_margin: Agents never walk faster than this times their preferred speed.

    Raises:
        ValueError: The piece is not positive or the margin below 1.
        ModuleNotFoundError: The library is not installed.

    Source:
        Moussaïd et al., Experimental study of the behavioural mechanisms underlying
        self-organization in pedestrian crowds (2009); forces and constants are those of the
        library.
    """

    max_step_s: float = 0.1
    speed_margin: float = 1.3

    def __post_init__(self) -> None:
        """Check the settings and the presence of the library once, at the border."""
        require_positive("max_step_s", self.max_step_s)
        require_at_least("speed_margin", self.speed_margin, 1.0)
        _library()

    def __call__(
        self, crowd: CrowdState, dt_s: float, robot: VisibleRobot | None = None
    ) -> Float[Tensor, "*b h 2"]:
        """Mean velocities of all pedestrians over the next step.

        Args:
            crowd: The pedestrians of all episodes.
            dt_s: Length of the step in s.
            robot: The robot, where the pedestrians see it.

        Returns:
            Velocities in m/s in the precision of the positions.
        """
        pedestrians = crowd.radius.shape[-1]
        if pedestrians == 0:
            return crowd.velocity
        state = torch.cat((crowd.position, crowd.velocity, crowd.goal), dim=-1)
        speed = crowd.preferred_speed
        if robot is not None:
            ahead = robot.position + robot.velocity
            moving = torch.cat((robot.position, robot.velocity, ahead), dim=-1)
            state = torch.cat((state, moving[..., None, :]), dim=-2)
            pace = robot.velocity.norm(dim=-1, keepdim=True)
            speed = torch.cat((speed, pace), dim=-1)
        states = state.detach().cpu().double().reshape(-1, *state.shape[-2:]).numpy()
        speeds = speed.detach().cpu().double().reshape(-1, speed.shape[-1]).numpy()
        means = [
            self._mean_velocity(_Agents(*agents), pedestrians, dt_s)
            for agents in zip(states, speeds, strict=True)
        ]
        return torch.from_numpy(np.stack(means)).reshape(crowd.velocity.shape).to(crowd.velocity)

    def _mean_velocity(self, agents: _Agents, pedestrians: int, dt_s: float) -> np.ndarray:
        """Move the agents of one episode for `dt_s`; mean velocity of its pedestrians in m/s."""
        pieces = int(np.ceil(dt_s / self.max_step_s - 1e-9))
        step_s = dt_s / pieces
        state = agents.state.copy()
        for _ in range(pieces):
            force = self._force(_Agents(state, agents.speed))[:pedestrians]
            wanted = state[:pedestrians, 2:4] + step_s * force
            pace = np.linalg.norm(wanted, axis=-1)
            limit = self.speed_margin * agents.speed[:pedestrians]
            slower = limit / np.maximum(pace, limit)
            state[:pedestrians, 2:4] = wanted * slower[:, None]
            state[:, :2] += step_s * state[:, 2:4]
        return (state[:pedestrians, :2] - agents.state[:pedestrians, :2]) / dt_s

    def _force(self, agents: _Agents) -> np.ndarray:
        """Force per mass in m/s² on every agent."""
        simulator = _library().Simulator(_apart(agents.state))
        # the library takes the speed at the start for the preferred one: nobody at rest would move
        simulator.peds.max_speeds = agents.speed
        return simulator.compute_forces()


def _apart(state: np.ndarray) -> np.ndarray:
    """Agents (a, 6) of whom none stands exactly where another does: no direction leads apart."""
    _, first = np.unique(state[:, :2], axis=0, return_index=True)
    later = np.setdiff1d(np.arange(len(state)), first)
    moved = state.copy()
    moved[later, 0] += ASIDE_M * np.arange(1, len(later) + 1)
    return moved


def _library() -> ModuleType:
    """Import the optional library; it sets up logging of its own, which is undone."""
    root = logging.getLogger()
    level, handlers, disabled = root.level, list(root.handlers), root.manager.disable
    was_there = Path(LEFT_BEHIND).exists()
    logging.disable(logging.INFO)
    try:
        with needs("crowd", "crowd=social_force"):
            return importlib.import_module(PACKAGE)
    finally:
        logging.disable(disabled)
        root.setLevel(level)
        added = [handler for handler in root.handlers if handler not in handlers]
        root.handlers[:] = handlers
        for handler in added:
            handler.close()
        if any(isinstance(handler, logging.FileHandler) for handler in added) and not was_there:
            Path(LEFT_BEHIND).unlink(missing_ok=True)
