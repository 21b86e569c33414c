"""One decision of a trained stack: observed agents as a sample, its answer in their world."""

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from diffstack_mmv.checks import (
    require,
    require_at_least,
    require_positive,
    require_switch,
    require_whole,
)
from diffstack_mmv.data.motions import tracks_of
from diffstack_mmv.device_checks import usable_device
from diffstack_mmv.geometry import (
    motion_from_frame,
    position_from_frame,
    position_in_frame,
    rotate,
    wrap_angle,
)
from diffstack_mmv.online.checks import point_of, require_known_now, require_observed
from diffstack_mmv.planning import PredictedGoal, WantedGoal
from diffstack_mmv.stack import load_stack
from diffstack_mmv.types import Forecast, Mode, Motion, Pose, StackBatch, Tracks, map_tensors
from dmmv_conventions.observed import ObservedAgents

_ALONE = threading.Lock()
"""Held while a stack computes: the forward derivatives of torch are those of the whole process."""


class Decision(NamedTuple):
    """What a stack decides, in the world of the observed agents and in float64."""

    plan: Motion  # T+1, the first row is now
    controls: Float[Tensor, "T m"]  # SI units, each held for one step
    control_names: tuple[str, ...]  # m
    solved: bool  # whether the optimiser converged
    goal: Float[Tensor, " 2"]  # m
    miss_m: float  # from the end of the plan to the goal: large where it is out of reach
    forecast: Forecast  # A K T, of the agents that counted
    names: tuple[str, ...]  # A, the ego first


class OnlineStack:
    """Forecasts all agents around an ego and plans for it, outside of any data set.

    It keeps nothing of a decision for the next one. Decisions of several threads wait in a line.

    Args:
        checkpoint: A checkpoint of a training, or the name of a shipped one: pretrained.
        neighbors: At most so many of the nearest agents count.
        radius_m: Agents further away do not.
        device: Where the stack is to be; auto is a GPU where there is one.
        compiled: Whether expensive parts are compiled now, which takes half a minute if the disk
            does not hold them, and decisions a fraction of the time. All decisions then have the
            shapes of `neighbors` agents, however many there are, so that none compiles anew.

    Raises:
        ValueError: There is no usable checkpoint or no such device, or a number is out of range.
    """

    def __init__(
        self,
        checkpoint: Path | str,
        neighbors: int = 16,
        radius_m: float = 30.0,
        device: torch.device | str = "cpu",
        compiled: bool = False,
    ) -> None:
        require_whole("neighbors", neighbors)
        require_at_least("neighbors", neighbors, 0)
        require_positive("radius_m", radius_m)
        require_switch("compiled", compiled)
        self.stack, config = load_stack(checkpoint, usable_device(str(device)))
        self.neighbors = neighbors
        self.radius_m = radius_m
        self.dt_s: float = config["dt_s"]
        self.history_s: float = config["history_s"]
        self.horizon_s: float = config["horizon_s"]
        self.modes: tuple[str, ...] = tuple(config["modes"])
        self._least_agents = 1 + neighbors if compiled else 1
        if compiled:
            self.stack.compile_kernels()
            self(self._one_of_each_kind())

    @torch.no_grad()
    def __call__(self, observed: ObservedAgents, goal: Sequence[float] | None = None) -> Decision:
        """Decide for the first agent.

        Args:
            observed: The agents, the last row is now.
            goal: Where the ego is to be after `horizon_s`, x and y in m in the world; where it is
                expected to go by itself if None. It is a wish: the plan begins with the observed
                motion, and leads as near as the limits of the planner let it, see `miss_m`.

        Returns:
            Forecast and plan.

        Raises:
            ValueError: The step is not that of the stack, the ego is none of its modes or not
                observed now, somebody else has a position now but no size, velocity or heading,
                arrays do not fit, or the goal is no point.
            TypeError: These are no observed agents, or a part of them is no array of numbers.
        """
        require_observed(observed)
        self._require_fitting(observed)
        origin = torch.from_numpy(observed.position[0, -1]).double()
        course = torch.tensor(float(observed.heading[0, -1]), dtype=torch.float64)
        chosen = self._chosen(observed)
        batch = self._batch(observed, chosen, origin, course)
        source = PredictedGoal()
        if goal is not None:
            source = WantedGoal()
            place = position_in_frame(point_of(goal), origin, course).unsqueeze(0)
            batch = batch._replace(goal=place.to(batch.goal))
        with _ALONE:
            output = self.stack.plan(batch, self.stack.predictor.predict(batch), source)
        motion, controls, aim = map_tensors(
            lambda entry: entry.squeeze(0).double().cpu(),
            (output.plan.motion, output.plan.controls, output.goal),
        )
        plan, wish = (
            motion_from_frame(motion, origin, course),
            position_from_frame(aim, origin, course),
        )
        return Decision(
            plan=plan,
            controls=controls,
            control_names=self.stack.planner.dynamics.Control._fields,
            solved=bool(output.plan.converged),
            goal=wish,
            miss_m=float((plan.position[-1] - wish).norm()),
            forecast=_forecast_in_world(output.forecast, len(chosen), origin, course),
            names=tuple(observed.names[index] for index in chosen),
        )

    def _one_of_each_kind(self) -> ObservedAgents:
        """An ego that rides along, and who is forecast in another way than it: what to compile."""
        modes = (self.modes[0], Mode.PEDESTRIAN.label, Mode.CAR.label)
        count, rows = len(modes), round(self.history_s / self.dt_s) + 1
        position = np.zeros((count, rows, 2))
        position[..., 0] = self.dt_s * np.arange(1 - rows, 1)
        position[:, :, 1] = min(2.0, self.radius_m / count) * np.arange(count)[:, None]
        velocity = np.tile([1.0, 0.0], (count, rows, 1))
        extent, heading = np.ones((count, 2)), np.zeros((count, rows))
        names = tuple(map(str, range(count)))
        return ObservedAgents(names, modes, extent, position, velocity, heading, self.dt_s)

    def _require_fitting(self, observed: ObservedAgents) -> None:
        require_positive("observed.dt_s", observed.dt_s)
        same = abs(observed.dt_s - self.dt_s) < 1e-9
        remedy = "Sample with the step of the stack, `dt_s`."
        require(same, "observed.dt_s", f"be {self.dt_s:g} s", observed.dt_s, "", remedy)
        rows, steps = observed.heading.shape[1], round(self.history_s / self.dt_s)
        remedy = "Sample with the history of the stack, `history_s`."
        require(rows == steps + 1, "observed", f"have {steps + 1} rows", rows, "", remedy)
        require_known_now(observed)
        mode = Mode.named(observed.modes[0], "observed.modes").label
        remedy = "Take a checkpoint of that mode."
        wanted = f"be one that the stack was trained on, {', '.join(self.modes)}"
        require(mode in self.modes, "mode of the ego", wanted, repr(mode), "", remedy)

    def _chosen(self, observed: ObservedAgents) -> list[int]:
        """The ego and the nearest others that are present now."""
        place = observed.position[:, -1]
        distance = np.linalg.norm(place - place[0], axis=-1)
        near = [index for index in range(1, len(place)) if distance[index] <= self.radius_m]
        return [0, *sorted(near, key=lambda index: distance[index])[: self.neighbors]]

    def _batch(
        self, observed: ObservedAgents, chosen: list[int], origin: Tensor, course: Tensor
    ) -> StackBatch:
        """One sample without a future in the frame of the ego now, filled up with absent agents."""
        position, velocity, heading = (
            torch.from_numpy(np.ascontiguousarray(part[chosen])).double()
            for part in (observed.position, observed.velocity, observed.heading)
        )
        states = torch.cat(
            [
                position_in_frame(position, origin, course),
                rotate(velocity, -course),
                wrap_angle(heading - course).unsqueeze(-1),
            ],
            -1,
        )
        names = (observed.modes[index] for index in chosen)
        modes = torch.tensor([int(Mode.named(name, "observed.modes")) for name in names])
        dtype = self.stack.planner.dynamics.bounds.lower.dtype
        extent = torch.from_numpy(observed.extent[chosen]).to(dtype)
        absent = max(self._least_agents - len(chosen), 0)
        states = pad(states, (0, 0, 0, 0, 0, absent), value=torch.nan)
        extent, modes = pad(extent, (0, 0, 0, absent)), pad(modes, (0, absent))
        past = tracks_of(states.to(dtype), extent, modes, states.shape[-2], self.dt_s)
        future = _without_rows(past, self.stack.predictor.horizon_steps)
        ego_past, ego_future, others_past, others_future = (
            map_tensors(lambda entry, part=part: entry[part].unsqueeze(0), tracks)
            for part in (0, slice(1, None))
            for tracks in (past, future)
        )
        pose = Pose(origin[None], course[None], torch.ones(1, dtype=torch.bool))
        goal = torch.zeros(1, 2, dtype=dtype)
        made = StackBatch(ego_past, ego_future, others_past, others_future, goal, self.dt_s, pose)
        return map_tensors(lambda entry: entry.to(self.stack.device), made)


def _without_rows(tracks: Tracks, rows: int) -> Tracks:
    """The same agents with so many rows of which none was observed."""
    motion = Motion(*(entry[:, :1].expand(-1, rows, *entry.shape[2:]) for entry in tracks.motion))
    absent = torch.zeros(len(tracks.mode), rows, dtype=torch.bool)
    return tracks._replace(motion=map_tensors(torch.zeros_like, motion), valid=absent)


def _forecast_in_world(forecast: Forecast, count: int, origin: Tensor, course: Tensor) -> Forecast:
    """A forecast `1 A` of the frame of the ego as one of the first `count` agents in the world."""
    here = map_tensors(lambda entry: entry[0, :count].double().cpu(), forecast)
    turned = rotate(here.scale_tril.mT, course).mT
    return Forecast(
        here.log_weight,
        position_from_frame(here.mean, origin, course),
        torch.linalg.cholesky(turned @ turned.mT),
    )
