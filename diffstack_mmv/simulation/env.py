"""The crowd as a gymnasium environment, `diffstack_mmv/CrowdNav-v0`."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from jaxtyping import Float

from diffstack_mmv.checks import (
    require,
    require_finite,
    require_one_of,
    require_positive,
    require_switch,
    require_whole,
)
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.dynamics.catalogue import VehicleSpec, load_vehicle, model_of
from diffstack_mmv.simulation.assembly import vehicle_box
from diffstack_mmv.simulation.collision import DiscFootprint, Footprint
from diffstack_mmv.simulation.crossings import SCENARIOS
from diffstack_mmv.simulation.pedestrians import OrcaCrowd
from diffstack_mmv.simulation.phases import PHASES
from diffstack_mmv.simulation.robot import HolonomicRobot, Robot, UnicycleRobot
from diffstack_mmv.simulation.scenario import Scenario
from diffstack_mmv.simulation.scene import Scene
from diffstack_mmv.simulation.vehicle_robot import FINEST_NEEDED_S, VehicleRobot
from diffstack_mmv.simulation.verdicts import verdict_named
from diffstack_mmv.simulation.views import WorldView
from diffstack_mmv.simulation.world import World, WorldState
from diffstack_mmv.types import Outcome

ENV_ID = "diffstack_mmv/CrowdNav-v0"
POINT_ROBOTS: dict[str, Callable[[], Robot]] = {
    "holonomic": HolonomicRobot,
    "unicycle": UnicycleRobot,
}
FOOTPRINTS: dict[str, Callable[[VehicleSpec, DynamicsModel], Footprint]] = {
    "disc": lambda spec, model: DiscFootprint(),
    "vehicle": vehicle_box,
}
"""Outline of a vehicle driven by a model, by its name."""


class EnvStep(NamedTuple):
    """What gymnasium expects of a step, in its order and by its names."""

    observation: dict[str, np.ndarray]
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]


def robot_named(
    name: str | Path, dynamics: str | None, dt_s: float, footprint: str = "disc"
) -> Robot:
    """Build a robot from the names that an environment takes.

    Args:
        name: "holonomic", "unicycle", or the name or YAML file of a vehicle.
        dynamics: Name of a vehicle's dynamics, a file of `configs/dynamics`; "gm3" where it is
            None. The other robots have none.
        dt_s: Step of the environment in s, which the vehicle's fine step divides.
        footprint: "disc", that of the benchmark, or "vehicle", the box of a vehicle.

    Returns:
        The robot.

    Raises:
        ValueError: There is no such robot, dynamics or footprint, or the step is not positive.
    """
    require_positive("dt_s", dt_s)
    require_one_of("footprint", footprint, tuple(FOOTPRINTS))
    if isinstance(name, str) and name in POINT_ROBOTS:
        where, remedy = f"for robot '{name}'", "Name a vehicle, as in robot='bicycle'."
        require(footprint == "disc", "footprint", "be disc", footprint, where, remedy)
        require(dynamics is None, "dynamics", "not be given", repr(dynamics), where, remedy)
        return POINT_ROBOTS[name]()
    pieces = math.ceil(dt_s / FINEST_NEEDED_S - 1e-9)
    spec = load_vehicle(name)
    model = model_of(spec, dynamics or "gm3", dt_s / pieces)
    return VehicleRobot(model, footprint=FOOTPRINTS[footprint](spec, model))


class CrowdNavEnv(gymnasium.Env[dict[str, Any], np.ndarray]):
    """One robot crosses a crowd: the CrowdNav benchmark with exact cases, and its mended version.

    An action holds for one step, in the units of the robot: (v_x, v_y) in m/s for "holonomic",
    (v in m/s, turn in rad) for "unicycle", the controls of the dynamics model for a vehicle.
    An observation has `robot` and `humans` in SI units and in the world frame, see `WorldView`.
    `reset(options={"phase": "test", "case": 7})` starts a case of the benchmark; without options
    the environment's generator draws a case of the training phase.

    Args:
        scenario: "circle_crossing", "square_crossing", or a scenario with settings of one's own.
        humans: Number of pedestrians; that of the scenario where one is given.
        dt_s: Length of a step.
        limit_s: Time limit, a multiple of the step.
        robot: "holonomic", "unicycle", the name or YAML file of a vehicle, or a robot.
        verdict: "crowdnav" (the original rules with their faults) or "exact".
        dynamics: Dynamics of a vehicle that is given by its name, "gm3" by default.
        robot_visible: Whether the pedestrians avoid the robot.
        render_mode: "rgb_array" or None.
        footprint: Outline of a robot that is given by its name: "disc", that of the benchmark, or
            "vehicle", the box of the vehicle.

    Raises:
        ValueError: A name is unknown, or a number out of range.

    Source:
        Chen et al., Crowd-Robot Interaction (ICRA 2019).
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 4}

    def __init__(
        self,
        scenario: str | Scenario = "circle_crossing",
        humans: int = 5,
        dt_s: float = 0.25,
        limit_s: float = 25.0,
        robot: str | Path | Robot = "holonomic",
        verdict: str = "crowdnav",
        dynamics: str | None = None,
        robot_visible: bool = False,
        render_mode: str | None = None,
        footprint: str = "disc",
    ) -> None:
        self._scenario = _scenario_named(scenario, humans)
        require_positive("limit_s", limit_s)
        require_switch("robot_visible", robot_visible)
        self._use(
            World(
                robot=_robot(robot, dynamics, dt_s, footprint),
                crowd=OrcaCrowd(),
                verdict=verdict_named(verdict, limit_s),
                dt_s=dt_s,
                robot_visible=robot_visible,
            ),
            render_mode,
        )

    @classmethod
    def from_world(
        cls, world: World, scenario: Scenario, render_mode: str | None = None
    ) -> "CrowdNavEnv":
        """Environment around any world: other pedestrians, footprints, robots or rewards.

        Args:
            world: The world.
            scenario: Where its episodes start, m.
            render_mode: "rgb_array" or None.

        Returns:
            The environment.
        """
        env = cls.__new__(cls)
        env._scenario = scenario
        env._use(world, render_mode)
        return env

    def _use(self, world: World, render_mode: str | None) -> None:
        """Set up the spaces for a world."""
        require_render_mode(render_mode)
        self.world = world
        self.render_mode = render_mode
        self.metadata = {**type(self).metadata, "render_fps": round(1 / world.dt_s)}
        lower, upper = (bound.double().numpy() for bound in world.robot.bounds)
        self.action_space = spaces.Box(lower, upper, dtype=np.float64)
        self._view = WorldView()
        self.observation_space = self._view.space(self._scenario.humans)
        self._state: WorldState | None = None
        self._ended = False

    @property
    def scenario(self) -> Scenario:
        """Where the episodes start."""
        return self._scenario

    @property
    def state(self) -> WorldState:
        """State of the world, without leading dimensions, SI units.

        Raises:
            RuntimeError: `reset` has not been called.
        """
        return begun(self._state)

    @property
    def human_positions(self) -> Float[np.ndarray, "humans 2"]:
        """Positions of the pedestrians in m."""
        return self.state.pedestrians.position.numpy().copy()

    @property
    def robot_position(self) -> Float[np.ndarray, " 2"]:
        """Position of the robot's centre in m."""
        return self.world.robot.motion(self.state.robot).position.numpy().copy()

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode.

        Args:
            seed: Seeds the generator that draws cases.
            options: "phase" ("train" by default) and "case"; without "case" one is drawn. Or
                "scene": a scene of one's own, in m and rad.

        Returns:
            Observation by name in the shapes of `observation_space`, and phase and case.

        Raises:
            ValueError: An option, phase or case does not exist, or the start is impossible.
        """
        super().reset(seed=seed)
        chosen = dict(options or {})
        for name in chosen:
            require_one_of("options", name, ("phase", "case", "scene"))
        phase = str(chosen.get("phase", "train"))
        require_one_of("phase", phase, tuple(PHASES))
        if "scene" in chosen:
            described, scene = {"phase": "own", "case": -1}, chosen["scene"]
            require(isinstance(scene, Scene), "scene", "be a Scene", type(scene).__name__)
        else:
            given = "case" in chosen
            case = chosen["case"] if given else self.np_random.integers(PHASES[phase].cases)
            require_whole("case", case)
            described = {"phase": phase, "case": int(case)}
            scene = self._scenario.case(phase, int(case))
        self._state = self.world.start(scene)
        self._ended = False
        return self._observation(), described

    def step(self, action: np.ndarray) -> EnvStep:
        """Advance by one step.

        Args:
            action: Action in the units of the robot.

        Returns:
            Observation, reward, whether the goal or a pedestrian was hit, whether the time is up,
            and outcome, clearance (m) and time (s).

        Raises:
            ValueError: The action is not finite or has the wrong shape.
            RuntimeError: The episode has ended, or has not begun.
        """
        if self._ended:
            raise RuntimeError(
                f"`step` must come within an episode, but got {action}. Call `reset`."
            )
        control = torch.as_tensor(np.asarray(action, dtype=np.float64))
        require_finite("action", control)
        self._state, judgement = self.world.step(self.state, control)
        outcome = Outcome(int(judgement.outcome))
        self._ended = outcome.ends_episode
        told = {
            "outcome": outcome.label,
            "clearance_m": float(judgement.clearance),
            "time_s": float(self._state.time),
        }
        terminated = outcome in (Outcome.COLLISION, Outcome.SUCCESS)
        late = outcome is Outcome.TIMEOUT
        return EnvStep(self._observation(), float(judgement.reward), terminated, late, told)

    def render(self) -> np.ndarray | None:
        """Picture of the present state, (height, width, 3) uint8, or None without a render mode."""
        if self.render_mode is None:
            return None
        from diffstack_mmv.simulation.drawing import picture

        return picture(self.world, self.state)

    def _observation(self) -> dict[str, np.ndarray]:
        """What a policy may know, SI units."""
        return self._view(self.world.observe(self.state))


def _robot(robot: str | Path | Robot, dynamics: str | None, dt_s: float, footprint: str) -> Robot:
    """The robot itself, or the one of that name."""
    if isinstance(robot, Robot):
        return robot
    named = isinstance(robot, str | Path)
    require(named, "robot", "be a name, a YAML file or a robot", repr(robot))
    return robot_named(robot, dynamics, dt_s, footprint)


def begun(state: WorldState | None) -> WorldState:
    """The state of an environment, SI units.

    Raises:
        RuntimeError: There is none: nothing has begun.
    """
    if state is None:
        raise RuntimeError("`state` must exist, but got None. Call `reset` first.")
    return state


def require_render_mode(render_mode: str | None) -> None:
    """Refuse what an environment cannot draw into.

    Raises:
        ValueError: It is neither None nor one of the render modes.
    """
    if render_mode is not None:
        require_one_of("render_mode", render_mode, CrowdNavEnv.metadata["render_modes"])


def _scenario_named(scenario: str | Scenario, humans: int) -> Scenario:
    """The scenario itself, or the one of that name with so many pedestrians."""
    if isinstance(scenario, Scenario):
        return scenario
    require_one_of("scenario", scenario, tuple(SCENARIOS))
    return SCENARIOS[scenario](humans=humans)


def register() -> None:
    """Make the environment known to gymnasium, once."""
    if ENV_ID not in gymnasium.registry:
        gymnasium.register(
            ENV_ID,
            entry_point="diffstack_mmv.simulation.env:CrowdNavEnv",
            vector_entry_point="diffstack_mmv.simulation.vector_env:crowd_nav_vector",
        )
