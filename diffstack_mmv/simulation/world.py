"""The world of the episodes: a pure step from state and action to the next state and a verdict."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffstack_mmv.checks import (
    message,
    require,
    require_columns,
    require_finite,
    require_multiple,
    require_positive,
    require_switch,
)
from diffstack_mmv.geometry import length
from diffstack_mmv.simulation.observation import Observation, Sensing
from diffstack_mmv.simulation.pedestrians import (
    AnyCrowdState,
    Crowd,
    CrowdState,
    Itinerary,
    RecordedCrowdState,
)
from diffstack_mmv.simulation.robot import Robot, seen_by_pedestrians
from diffstack_mmv.simulation.scene import Scene
from diffstack_mmv.simulation.verdict import Encounter, Judgement, Verdict, clearance_at_rest
from diffstack_mmv.types import map_tensors


class WorldState(NamedTuple):
    """Everything that a step depends on, for a batch `*b` of episodes."""

    robot: Any  # the record of the world's robot
    pedestrians: AnyCrowdState
    goal: Float[Tensor, "*b 2"]  # m, of the robot
    time: Float[Tensor, "*b"]  # s
    case: Int[Tensor, "*b"]  # number of the case, to which the draws of all noise belong
    itinerary: Itinerary | None = None  # where the pedestrians go after their goals


class WorldStep(NamedTuple):
    """Result of one step; the verdict means nothing for an episode that had ended before."""

    state: WorldState
    judgement: Judgement


@dataclass(frozen=True)
class World:
    """Robot, pedestrian model and verdict; it holds no state and works on any batch of episodes.

    Attributes:
        robot: What an action does, and the outline.
        crowd: How the pedestrians choose their velocities.
        verdict: How a step is judged; it also knows the limit.
        dt_s: Length of a step, in which an action and the velocities of the pedestrians hold.
        robot_visible: Whether the pedestrians avoid the robot; in the benchmark they do not.
        reveals_s: How far the observations tell what is recorded to come, for controllers that show
            what a perfect forecast would be worth; 0 for all others.
        sensing: What the robot sees of the pedestrians; everything if None.

    Raises:
        ValueError: The step is not positive, or limit or `reveals_s` are no multiple of it.
    """

    robot: Robot
    crowd: Crowd
    verdict: Verdict
    dt_s: float = 0.25
    robot_visible: bool = False
    reveals_s: float = 0.0
    sensing: Sensing | None = None

    def __post_init__(self) -> None:
        """Check the settings once, at the border."""
        require_positive("dt_s", self.dt_s)
        require_switch("robot_visible", self.robot_visible)
        require_multiple("limit_s", self.verdict.limit_s, self.dt_s, "for the step `dt_s`")
        if self.reveals_s:
            require_multiple("reveals_s", self.reveals_s, self.dt_s, "for the step `dt_s`")

    @property
    def max_steps(self) -> int:
        """Steps until the limit."""
        return round(self.verdict.limit_s / self.dt_s)

    def start(self, scene: Scene) -> WorldState:
        """State at the start of scenes of the shape `*b`.

        Raises:
            ValueError: A pedestrian stands in the robot at the start.
        """
        state = WorldState(
            robot=self.robot.start(scene),
            pedestrians=scene.pedestrians,
            goal=scene.robot_goal,
            time=torch.zeros_like(scene.robot_heading),
            case=scene.case_numbers(),
            itinerary=scene.itinerary,
        )
        clearance = self.clearance(state)
        bad = int((clearance < 0).sum())
        if bad:
            radius = self.robot.footprint.radius_m
            raise ValueError(
                message(
                    "scene",
                    "start without a collision",
                    f"a clearance of {clearance.min():.3f} m, {bad} of {clearance.numel()} below 0",
                    remedy=f"Give the scenario a `robot_radius_m` of {radius:.2f}, which holds the "
                    "robot, or a larger `clearance_m`.",
                )
            )
        return state

    def step(self, state: WorldState, action: Float[Tensor, "*b m"]) -> WorldStep:
        """Robot and pedestrians move at once, from the present state.

        Args:
            state: State of all episodes, `*b`.
            action: Action of the robot, in its own units.

        Returns:
            The next state and the verdict on the step.

        Raises:
            ValueError: The action has the wrong number of columns or episodes, or is not finite.
        """
        require_columns("action", action, len(self.robot.bounds.lower))
        found, wanted = tuple(action.shape[:-1]), tuple(state.time.shape)
        require(found == wanted, "action", f"have one row per episode, {wanted}", found)
        require_finite("action", action, "", "The controller has to answer with numbers.")
        seen = seen_by_pedestrians(self.robot, state.robot)
        velocity = self.crowd(state.pedestrians, self.dt_s, seen if self.robot_visible else None)
        travel = self.robot.step(state.robot, action, self.dt_s)
        judgement = self.verdict(
            Encounter(
                path=travel.path,
                footprint=self.robot.footprint,
                velocity=travel.velocity,
                pedestrians=state.pedestrians,
                pedestrian_velocity=velocity,
                goal=state.goal,
                time=state.time,
                dt_s=self.dt_s,
            )
        )
        time, itinerary = state.time + self.dt_s, state.itinerary
        pedestrians = state.pedestrians.moved(velocity, self.dt_s)
        if itinerary is not None and isinstance(pedestrians, CrowdState):
            pedestrians, itinerary = itinerary.followed(pedestrians, state.time, time)
        after = WorldState(travel.state, pedestrians, state.goal, time, state.case, itinerary)
        return WorldStep(after, judgement)

    def observe(self, state: WorldState) -> Observation:
        """What a controller may know of the state, m, rad and m/s."""
        seen = seen_by_pedestrians(self.robot, state.robot)
        discs = map_tensors(
            lambda field: field.to(seen.radius).expand(*seen.radius.shape, -1),
            self.robot.footprint.discs(),
        )
        observation = Observation(
            motion=self.robot.motion(state.robot),
            velocity=seen.velocity,
            radius=seen.radius,
            discs=discs,
            goal=state.goal,
            pedestrian_position=state.pedestrians.position,
            pedestrian_velocity=state.pedestrians.velocity,
            pedestrian_radius=state.pedestrians.radius,
            seen=state.pedestrians.present,
            time=state.time,
            case=state.case,
            running=torch.ones_like(state.time, dtype=torch.bool),
            history=state.pedestrians.history(),
            future=self._revealed(state.pedestrians),
        )
        return observation if self.sensing is None else self.sensing(observation)

    def _revealed(self, pedestrians: AnyCrowdState) -> Float[Tensor, "*b h T 2"] | None:
        """What is recorded to come, in m, where the world reveals it.

        Raises:
            ValueError: There is no recording.
        """
        if not self.reveals_s:
            return None
        if isinstance(pedestrians, RecordedCrowdState):
            return pedestrians.future(round(self.reveals_s / self.dt_s))
        remedy = "Choose crowd=replay."
        told = type(pedestrians).__name__
        raise ValueError(message("reveals_s", "be 0 without a recording", told, "", remedy))

    def way_left(self, state: WorldState) -> Float[Tensor, "*b"]:
        """Distance in m from the robot's centre to its goal."""
        return length(state.goal - self.robot.motion(state.robot).position)

    def clearance(self, state: WorldState) -> Float[Tensor, "*b"]:
        """Clearance in m between the robot and the nearest pedestrian at this instant."""
        motion = self.robot.motion(state.robot)
        return clearance_at_rest(motion, self.robot.footprint, state.pedestrians)
