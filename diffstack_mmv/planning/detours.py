"""Candidate plans among agents: pass left or right of somebody, wait, or go."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import (
    require,
    require_at_least,
    require_between,
    require_positive,
    require_switch,
    require_whole,
)
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.planning.candidates import Candidates, roll_out
from diffstack_mmv.planning.pursuit import Leg, Pursuit
from diffstack_mmv.types import PlanningProblem


class Detour(NamedTuple):
    """Legs of each candidate, one after the other; then it makes for the goal at full speed."""

    offset: Float[Tensor, "C legs"]  # rad, course relative to the direction of the goal
    speed_share: Float[Tensor, "C legs"]  # of the cruising speed; negative: backwards on its course
    until: Float[Tensor, "C legs"]  # s, end of the leg, not before that of the leg before


def drawn_detours(count: int, until_s: float) -> Detour:
    """Two legs per candidate in any direction, at any speed, that end by a time: Sobol's points.

    A sixth of the legs are at rest and a sixth at full speed, so that waiting and fleeing are among
    few draws already.
    """
    points = torch.quasirandom.SobolEngine(6).draw(count + 1)[1:]
    share = (1.5 * points[:, 2:4] - 0.25).clamp(0, 1)
    return Detour(
        offset=math.pi * (2 * points[:, :2] - 1),
        speed_share=share,
        until=until_s * points[:, 4:].sort(-1).values,
    )


def backing_detours(count: int, until_s: float) -> Detour:
    """The same with a first leg that is driven backwards, none of them slowly."""
    drawn = drawn_detours(count, until_s)
    backwards = -0.5 - 0.5 * drawn.speed_share[:, :1]
    return drawn._replace(speed_share=torch.cat([backwards, drawn.speed_share[:, 1:]], -1))


class DetourFan:
    """Every candidate holds a course and a speed for a while and then makes for the goal.

    Courses to the left and right of the goal at several speeds, zero among them, span the ways
    around the agents: before or behind each of them, left or right, wait or go. All are driven
    through the dynamics by pure pursuit, so each is feasible for the vehicle. Among many agents who
    are as fast as the vehicle that is not enough: `drawn` adds candidates with two such legs, which
    may lead back. The last candidate is maximal braking with the steering that keeps the path
    straight.

    Args:
        offsets_deg: Courses to one side of the goal; the other side mirrors them, zero is added.
        speed_shares: Speeds of the first phase as shares of the cruising speed.
        durations_s: Lengths of the first phase.
        drawn: Number of candidates with two legs; the same ones for every problem.
        drawn_until_s: Time at which the last of their legs ends.
        backing: Number of further candidates of this kind that begin backwards.
        pursuit: How courses and the goal are pursued.
        compile: Roll out in a generated library, on a CPU with a compiler.

    Raises:
        ValueError: A list is empty or a number out of range, or the vehicle, when it is known, can
            only drive forward and should begin backwards.
    """

    def __init__(
        self,
        offsets_deg: Sequence[float] = (15.0, 30.0, 50.0, 80.0),
        speed_shares: Sequence[float] = (0.0, 0.33, 0.67, 1.0),
        durations_s: Sequence[float] = (0.5, 1.0, 1.75),
        drawn: int = 0,
        drawn_until_s: float = 4.0,
        backing: int = 0,
        pursuit: Pursuit | None = None,
        compile: bool = False,
    ) -> None:
        for name, values in (
            ("offsets_deg", offsets_deg),
            ("speed_shares", speed_shares),
            ("durations_s", durations_s),
        ):
            require_at_least(f"len({name})", len(values), 1)
        for offset in offsets_deg:
            require_between("offsets_deg", offset, 0, 180)
        for share in speed_shares:
            require_between("speed_shares", share, 0, 1)
        for name, count in (("drawn", drawn), ("backing", backing)):
            require_whole(name, count)
            require_at_least(name, count, 0)
        require_positive("drawn_until_s", drawn_until_s)
        require_switch("compile", compile)
        one_side = [math.radians(offset) for offset in offsets_deg]
        both = torch.tensor([-offset for offset in reversed(one_side)] + [0.0] + one_side)
        grid = torch.cartesian_prod(both, torch.tensor(speed_shares), torch.tensor(durations_s))
        legs = (field[:, None].expand(-1, 2) for field in grid.unbind(-1))
        more = (drawn_detours(drawn, drawn_until_s), backing_detours(backing, drawn_until_s))
        self.detour = Detour(*map(torch.cat, zip(Detour(*legs), *more, strict=True)))
        self.backing = backing
        self.pursuit = pursuit or Pursuit()
        self.compile = compile
        self._schedules: dict[tuple[int, float, torch.dtype, torch.device], Tensor] = {}

    def __call__(self, dynamics: DynamicsModel, problem: PlanningProblem, steps: int) -> Candidates:
        """Roll out the fan of every problem over a number of steps.

        Args:
            dynamics: The vehicle.
            problem: Problems, `*b`.
            steps: Length of the horizon in steps of the dynamics.

        Returns:
            The candidates `*b C`, maximal braking last.
        """
        remedy = "Set `backing` to 0, or choose dynamics that can reverse."
        forward_only = self.backing > 0 and not dynamics.can_reverse
        require(
            not forward_only, "dynamics", "be able to reverse", "one that cannot", remedy=remedy
        )
        pursuit = self.pursuit

        def control_of(state: Tensor, row: Tensor) -> Tensor:
            goal, cruise, offset, share, detours, brakes = row.split([2, 1, 1, 1, 1, 1], -1)
            leg = Leg(offset[..., 0], share[..., 0], detours[..., 0] > 0)
            arc = pursuit.arc(dynamics, state, leg, goal, cruise[..., 0])
            hardest = brakes[..., 0] > 0
            braking = dynamics.hardest_braking(state)
            acceleration = torch.where(hardest, braking, arc.acceleration)
            curvature = torch.where(hardest, torch.zeros_like(arc.curvature), arc.curvature)
            return dynamics.control_for(state, acceleration, curvature)

        detour = Detour(*(field.to(problem.goal) for field in self.detour))
        rows = _rows(problem, self._scheduled(detour, steps, dynamics.dt_s))
        return roll_out(dynamics, problem, rows, control_of, self.compile)

    def _scheduled(self, detour: Detour, steps: int, dt_s: float) -> Float[Tensor, "C1 T 4"]:
        """What the candidates do in each step: the same for all problems, so worked out once."""
        like = detour.until
        key = steps, dt_s, like.dtype, like.device
        if key not in self._schedules:
            legs = [_leg(detour, step * dt_s) for step in range(steps)]
            self._schedules[key] = _schedule(legs, like)
        return self._schedules[key]


def _leg(detour: Detour, time_s: float) -> Leg:
    """The leg of each candidate in the step that begins at this time."""
    left = time_s < detour.until - 1e-6
    second = ~left[:, 0]
    offset, share = (torch.where(second, field[:, 1], field[:, 0]) for field in detour[:2])
    return Leg(offset, share, left.any(-1))


def _schedule(legs: Sequence[Leg], like: Tensor) -> Float[Tensor, "C1 T 4"]:
    """The leg of each candidate in each step, and whether it brakes, which the last one does."""
    told = [torch.stack([field.to(like) for field in leg], -1) for leg in legs]
    each = torch.nn.functional.pad(torch.stack(told, -2), (0, 1, 0, 0, 0, 1))
    each[-1, :, -1] = 1
    return each


def _rows(problem: PlanningProblem, schedule: Float[Tensor, "C T 4"]) -> Float[Tensor, "*b C T 7"]:
    """What each candidate is told in each step: goal and cruise, and its part of the schedule."""
    common = torch.cat([problem.goal, problem.reference_speed.unsqueeze(-1)], -1)
    shape = *common.shape[:-1], *schedule.shape[:-1]
    told = common[..., None, None, :].expand(*shape, 3), schedule.expand(*shape, 4)
    return torch.cat(told, -1)
