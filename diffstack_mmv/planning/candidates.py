"""Candidate plans, each the motion of the model under admissible controls."""

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import (
    require_at_least,
    require_positive,
    require_switch,
    require_whole,
)
from diffstack_mmv.control import pad_controls
from diffstack_mmv.control.native.scan import scan
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.planning.problem import initial_state
from diffstack_mmv.types import Motion, PlanningProblem, map_tensors


class Candidates(NamedTuple):
    """Candidate plans of each problem."""

    states: Float[Tensor, "*b C T1 n"]
    controls: Float[Tensor, "*b C T m"]
    motion: Motion  # *b C T+1


class Arc(NamedTuple):
    """A constant acceleration along an arc of constant curvature."""

    acceleration: Float[Tensor, "*b C"]  # m/s²
    curvature: Float[Tensor, "*b C"]  # 1/m


@runtime_checkable
class CandidateSource(Protocol):
    """Proposes plans; where nothing else is left, a controller drives the last of them."""

    def __call__(self, dynamics: DynamicsModel, problem: PlanningProblem, steps: int) -> Candidates:
        """Candidates of every problem over a number of steps of the dynamics."""
        ...


ControlOf = Callable[[Float[Tensor, "*b n"], Float[Tensor, "*b k"]], Float[Tensor, "*b m"]]
"""(states, what each candidate is told in a step) -> controls."""


class Coasting:
    """Proposes nothing of its own: one plan without any control, where an optimiser may start."""

    def __call__(self, dynamics: DynamicsModel, problem: PlanningProblem, steps: int) -> Candidates:
        """Roll out zero controls for every problem over a number of steps."""
        shape = *problem.goal.shape[:-1], 1, steps, dynamics.control_dim
        return roll_out(dynamics, problem, problem.goal.new_zeros(shape), as_told)


class CandidateFan:
    """Lattice of terminal speeds and lateral offsets, rolled out through the selected dynamics.

    A terminal speed fixes a constant acceleration, a lateral offset y at the end of the path of
    length s an arc of curvature 2 y / s²; one more candidate is the arc with constant acceleration
    that ends at the goal. Each is the motion of the model under admissible controls, and curves no
    more than its tyres hold, so all are feasible for the vehicle.

    Args:
        speeds: Number of terminal speeds, evenly spread within reach; an odd number keeps the
            present one.
        offsets: Number of lateral offsets, an odd number keeps the straight line.
        speed_change_mps: Largest change of speed over the horizon in m/s.
        offset_share: Largest lateral offset as a share of the length of the path.
        speed_max_mps: Speed that no candidate exceeds, in m/s, unless the vehicle does already.
        compile: Roll out in a generated library where there is a C++ compiler.

    Raises:
        ValueError: A number is below 1 or no whole one, or a range is not positive.
    """

    def __init__(
        self,
        speeds: int = 7,
        offsets: int = 9,
        speed_change_mps: float = 3.0,
        offset_share: float = 0.5,
        speed_max_mps: float = 12.0,
        compile: bool = False,
    ) -> None:
        for name, count in (("speeds", speeds), ("offsets", offsets)):
            require_whole(name, count)
            require_at_least(name, count, 1)
        for name, value in (
            ("speed_change_mps", speed_change_mps),
            ("speed_max_mps", speed_max_mps),
        ):
            require_positive(name, value)
        require_positive("offset_share", offset_share)
        require_switch("compile", compile)
        self.speeds = speeds
        self.offsets = offsets
        self.speed_change_mps = speed_change_mps
        self.offset_share = offset_share
        self.speed_max_mps = speed_max_mps
        self.compile = compile

    def __call__(self, dynamics: DynamicsModel, problem: PlanningProblem, steps: int) -> Candidates:
        """Roll out the fan of every problem over a number of steps."""
        horizon_s = steps * dynamics.dt_s
        lattice, to_goal = self._lattice(problem, horizon_s), self._to_goal(problem, horizon_s)
        arc = map_tensors(lambda *pair: torch.cat(pair, -1), lattice, to_goal)
        rows = torch.stack(arc, -1).unsqueeze(-2)

        def control_of(state: Tensor, row: Tensor) -> Tensor:
            acceleration, curvature = row.unbind(-1)
            held = dynamics.curvature_within_grip(state, acceleration, curvature)
            return dynamics.control_for(state, acceleration, held)

        each = rows.expand(*rows.shape[:-2], steps, -1)
        return roll_out(dynamics, problem, each, control_of, self.compile)

    def _lattice(self, problem: PlanningProblem, horizon_s: float) -> Arc:
        speed = problem.ego.motion.velocity[..., 0].clamp_min(0).unsqueeze(-1)
        change = _spread(self.speeds, speed)
        # whoever is faster already need not brake
        fastest = speed.clamp_min(self.speed_max_mps)
        final = (speed + self.speed_change_mps * change).clamp_min(0).minimum(fastest)
        acceleration = (final - speed) / horizon_s
        length = (0.5 * (speed + final) * horizon_s).clamp_min(1.0)
        curvature = 2 * self.offset_share * _spread(self.offsets, speed) / length.unsqueeze(-1)
        return Arc(
            acceleration.unsqueeze(-1).expand_as(curvature).flatten(-2), curvature.flatten(-2)
        )

    def _to_goal(self, problem: PlanningProblem, horizon_s: float) -> Arc:
        motion = problem.ego.motion
        offset = problem.goal - motion.position
        cosine, sine = motion.heading.cos(), motion.heading.sin()
        left = offset[..., 1] * cosine - offset[..., 0] * sine
        ahead = offset[..., 0] * cosine + offset[..., 1] * sine
        chord = offset.square().sum(-1).clamp_min(1e-6)
        half_turn = torch.atan2(left, ahead).clamp(-0.45 * math.pi, 0.45 * math.pi)
        length = chord.sqrt() * half_turn / torch.where(half_turn == 0, 1.0, half_turn).sin()
        length = torch.where(half_turn == 0, chord.sqrt(), length)
        acceleration = 2 * (length - motion.velocity[..., 0] * horizon_s) / horizon_s**2
        curvature = 2 * half_turn.sin() / chord.sqrt().clamp_min(0.5)
        return Arc(acceleration.unsqueeze(-1), curvature.unsqueeze(-1))


def _spread(count: int, like: Tensor) -> Float[Tensor, " count"]:
    """Numbers from -1 to 1, evenly spread; 0 exactly is among any odd number of them."""
    end = 1 if count > 1 else 0
    return torch.linspace(-end, end, count, device=like.device, dtype=like.dtype)


def as_told(state: Float[Tensor, "*b n"], row: Float[Tensor, "*b m"]) -> Float[Tensor, "*b m"]:
    """The control of candidates that are told their controls, for `roll_out`."""
    return row


def roll_out(
    dynamics: DynamicsModel,
    problem: PlanningProblem,
    rows: Float[Tensor, "*b C T k"],
    control_of: ControlOf,
    compile: bool = False,
) -> Candidates:
    """Drive C candidates of every problem over T steps.

    Args:
        dynamics: The vehicle.
        problem: Problems, `*b`.
        rows: What each candidate is told in each step.
        control_of: Controls of a step, from the states in which it begins and from what is told.
        compile: Roll out in a generated library where there is one, without a gradient.
    """

    def step(state: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        control = control_of(state, row)
        # a view, because a library takes down operations: what is handed on as it came is none
        return dynamics.step(state, control), control[..., :]

    present = initial_state(dynamics, problem.ego).unsqueeze(-2)
    start = present.expand(*rows.shape[:-2], present.shape[-1])
    found = None
    if compile:
        found = scan(step, start.flatten(0, -2), rows.flatten(0, -3), [control_of])
    if found is not None:
        states, controls = (part.unflatten(0, rows.shape[:-2]) for part in found)
    else:
        states, controls = _in_tensors(dynamics, start, rows, control_of)
    return Candidates(states, controls, dynamics.motion(states, pad_controls(controls)))


def _in_tensors(
    dynamics: DynamicsModel,
    start: Float[Tensor, "*b n"],
    rows: Float[Tensor, "*b T k"],
    control_of: ControlOf,
) -> tuple[Float[Tensor, "*b T1 n"], Float[Tensor, "*b T m"]]:
    states, controls = [start], []
    for row in rows.unbind(-2):
        controls.append(control_of(states[-1], row))
        states.append(dynamics(states[-1], controls[-1]))
    return torch.stack(states, -2), torch.stack(controls, -2)
