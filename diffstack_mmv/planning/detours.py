"""Candidate plans among agents: pass left or right of somebody, wait, or go."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_between, require_positive
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.geometry import wrap_angle
from diffstack_mmv.planning.candidates import Arc, ArcFan, Candidates, follow
from diffstack_mmv.types import PlanningProblem

CREEP_MPS = 1.0
"""A turn to the goal slows down no further than to this."""


class Detour(NamedTuple):
    """Legs of each candidate, one after the other; then it makes for the goal at full speed."""

    offset: Float[Tensor, "C legs"]  # rad, course relative to the direction of the goal
    speed_share: Float[Tensor, "C legs"]  # of the cruising speed
    until: Float[Tensor, "C legs"]  # s, end of the leg, not before that of the leg before


class Leg(NamedTuple):
    """What each candidate does in one step."""

    offset: Float[Tensor, " C"]  # rad
    speed_share: Float[Tensor, " C"]
    detours: Bool[Tensor, " C"]  # false: it makes for the goal


def drawn_detours(count: int, until_s: float) -> Detour:
    """Two legs per candidate in any direction, at any speed, that end by a time: Sobol's points.

    A third of the legs are at rest and a third at full speed, so that waiting and fleeing are among
    few draws already.
    """
    points = torch.quasirandom.SobolEngine(6).draw(count + 1)[1:]
    share = (1.5 * points[:, 2:4] - 0.25).clamp(0, 1)
    return Detour(
        offset=math.pi * (2 * points[:, :2] - 1),
        speed_share=share,
        until=until_s * points[:, 4:].sort(-1).values,
    )


class DetourFan(ArcFan):
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
        turn_time_s: Time in which an error of the course is steered out.
        lateral_mps2: Largest lateral acceleration of a turn.
        braking_mps2: Deceleration towards the goal.
        drawn: Number of candidates with two legs; the same ones for every problem.
        drawn_until_s: Time at which the last of their legs ends.

    Raises:
        ValueError: A list is empty or a number out of range.
    """

    def __init__(
        self,
        offsets_deg: Sequence[float] = (15.0, 30.0, 50.0, 80.0),
        speed_shares: Sequence[float] = (0.0, 0.33, 0.67, 1.0),
        durations_s: Sequence[float] = (0.5, 1.0, 1.75),
        turn_time_s: float = 0.3,
        lateral_mps2: float = 4.0,
        braking_mps2: float = 2.5,
        drawn: int = 0,
        drawn_until_s: float = 4.0,
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
        require_positive("turn_time_s", turn_time_s)
        require_positive("lateral_mps2", lateral_mps2)
        require_positive("braking_mps2", braking_mps2)
        require_at_least("drawn", drawn, 0)
        require_positive("drawn_until_s", drawn_until_s)
        one_side = [math.radians(offset) for offset in offsets_deg]
        both = torch.tensor([-offset for offset in reversed(one_side)] + [0.0] + one_side)
        grid = torch.cartesian_prod(both, torch.tensor(speed_shares), torch.tensor(durations_s))
        legs = (field[:, None].expand(-1, 2) for field in grid.unbind(-1))
        pairs = zip(Detour(*legs), drawn_detours(drawn, drawn_until_s), strict=True)
        self.detour = Detour(*map(torch.cat, pairs))
        self.turn_time_s = turn_time_s
        self.lateral_mps2 = lateral_mps2
        self.braking_mps2 = braking_mps2

    def __call__(self, dynamics: DynamicsModel, problem: PlanningProblem, steps: int) -> Candidates:
        """Roll out the fan of every problem over a number of steps.

        Args:
            dynamics: The vehicle.
            problem: Problems, `*b`.
            steps: Length of the horizon in steps of the dynamics.

        Returns:
            The candidates `*b C`, maximal braking last.
        """
        detour = Detour(*(field.to(problem.goal) for field in self.detour))
        braking = dynamics.bounds.lower[0].to(problem.goal)

        def arc_at(state: Tensor, step: int) -> Arc:
            pursued = self._pursued(dynamics, state[..., :-1, :], detour, problem, step)
            hardest = braking.expand(state[..., -1:, 0].shape)
            straight = torch.zeros_like(hardest)
            return Arc(
                *(torch.cat(pair, -1) for pair in zip(pursued, (hardest, straight), strict=True))
            )

        count = detour.offset.shape[0] + 1
        return follow(dynamics, problem, arc_at, count, steps, self.arc_step(dynamics))

    def _pursued(
        self,
        dynamics: DynamicsModel,
        state: Float[Tensor, "*b C n"],
        detour: Detour,
        problem: PlanningProblem,
        step: int,
    ) -> Arc:
        """Arcs of all candidates but the braking in one step."""
        none = torch.zeros_like(dynamics.bounds.lower).to(state)
        motion = dynamics.motion(state, none.expand(*state.shape[:-1], len(none)))
        way = problem.goal.unsqueeze(-2) - motion.position
        distance = way.square().sum(-1).sqrt()
        leg = _leg(detour, step * dynamics.dt_s)
        bearing = torch.atan2(way[..., 1], way[..., 0]) + torch.where(leg.detours, leg.offset, 0.0)
        error = wrap_angle(bearing - motion.heading)
        speed = motion.velocity[..., 0]
        cruise = problem.reference_speed.unsqueeze(-1)
        # on the way to the goal no faster than its arc allows, or a fast vehicle would circle it
        turning = self._arc_speed(distance, error)
        target = torch.where(leg.detours, cruise * leg.speed_share, torch.minimum(cruise, turning))
        stopping = (2 * self.braking_mps2 * distance).sqrt()
        # at the start of the step the target must be one that the step can still brake for
        target = torch.minimum(target, stopping)
        moving = speed.clamp_min(0.5)
        sharpest = self.lateral_mps2 / moving.square()
        curvature = error / (self.turn_time_s * moving)
        curvature = torch.minimum(torch.maximum(curvature, -sharpest), sharpest)
        return Arc((target - speed) / dynamics.dt_s, curvature)

    def _arc_speed(
        self, distance: Float[Tensor, "*b C"], error: Float[Tensor, "*b C"]
    ) -> Float[Tensor, "*b C"]:
        """Speed in m/s on the arc to the goal, of radius d / (2 sin β), or d / 2 to a goal behind.

        Not below `CREEP_MPS`: in tighter turns the steering is the limit.
        """
        sine = torch.where(error.abs() < 0.5 * math.pi, error.abs().sin(), 1.0)
        radius = 0.5 * distance / sine.clamp_min(1e-3)
        return (self.lateral_mps2 * radius).sqrt().clamp_min(CREEP_MPS)


def _leg(detour: Detour, time_s: float) -> Leg:
    """The leg of each candidate in the step that begins at this time."""
    left = time_s < detour.until - 1e-6
    second = ~left[:, 0]
    offset, share = (torch.where(second, field[:, 1], field[:, 0]) for field in detour[:2])
    return Leg(offset, share, left.any(-1))
