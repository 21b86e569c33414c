"""The two verdicts: that of the original benchmark, with its faults, and the exact one."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_one_of, require_positive
from diffstack_mmv.simulation.collision import ClosestApproach
from diffstack_mmv.simulation.verdict import Encounter, Verdict
from diffstack_mmv.types import Outcome

EARLY_S = 1.0
"""By how much the original benchmark ends an episode before its limit."""
ROUNDING_S = 1e-9
"""Slack for a clock that adds up steps."""


@dataclass(frozen=True)
class CrowdNavVerdict(Verdict):
    """The verdict of the original benchmark, with its faults.

    A collision is looked for along the velocities that the pedestrians had before the step. The
    time is up in the first step that starts one second or less before the limit, and a time-out
    hides collision and success. Needed to compare with published numbers.

    Attributes:
        limit_s: Time limit of an episode, which ends about one second earlier.
        goal_tolerance_m: The goal counts as reached where a step ends closer than this to it.
        rewards: What each outcome is worth.

    Raises:
        ValueError: The limit is not above one second, or the tolerance not positive.
    """

    precedence = Outcome.DISCOMFORT, Outcome.SUCCESS, Outcome.COLLISION, Outcome.TIMEOUT

    def __post_init__(self) -> None:
        """Check the sizes once, at the border."""
        super().__post_init__()
        remedy = f"Episodes end {EARLY_S} s early under this verdict; take a later limit."
        require_positive("limit_s - 1", self.limit_s - EARLY_S, remedy=remedy)

    def _clearance(self, step: Encounter) -> Float[Tensor, "*b h"]:
        """Straight motion at the robot's mean velocity and the pedestrians' old ones."""
        start = step.pedestrians.position - step.path.position[..., :1, :]
        relative = step.pedestrians.velocity - step.velocity[..., None, :]
        first, last = (
            step.path.heading[..., end, None].expand(start.shape[:-1]) for end in (0, -1)
        )
        end = start + relative * step.dt_s
        return step.footprint.clearance(
            ClosestApproach(start, end, step.pedestrians.radius, first, last)
        )

    def _is_late(self, step: Encounter) -> Bool[Tensor, "*b"]:
        """The clock before the step stands within a second of the limit."""
        return step.time >= self.limit_s - EARLY_S


@dataclass(frozen=True)
class ExactVerdict(Verdict):
    """The same rules with the two faults mended.

    A collision is looked for between the fine path of the robot and the pedestrians as they truly
    move in this step; the time is up at the limit; collision and success come before time-out.

    Attributes:
        limit_s: Time limit of an episode.
        goal_tolerance_m: The goal counts as reached where a step ends closer than this to it.
        rewards: What each outcome is worth.

    Raises:
        ValueError: The limit or the tolerance is not positive.
    """

    precedence = Outcome.DISCOMFORT, Outcome.TIMEOUT, Outcome.SUCCESS, Outcome.COLLISION

    def _clearance(self, step: Encounter) -> Float[Tensor, "*b h"]:
        """Smallest over the pieces of the path, each a straight relative motion, in m."""
        points = step.path.position.shape[-2]
        time = torch.linspace(0, step.dt_s, points, dtype=step.time.dtype, device=step.time.device)
        travelled = step.pedestrian_velocity[..., None, :] * time[:, None]
        pedestrian = step.pedestrians.position[..., None, :] + travelled
        relative = pedestrian - step.path.position[..., None, :, :]
        heading = step.path.heading[..., None, :].expand(relative.shape[:-1])
        radius = step.pedestrians.radius[..., None].expand(relative.shape[:-1])
        approach = ClosestApproach(
            start=relative[..., :-1, :],
            end=relative[..., 1:, :],
            radius=radius[..., 1:],
            start_heading=heading[..., :-1],
            end_heading=heading[..., 1:],
        )
        return step.footprint.clearance(approach).amin(dim=-1)

    def _is_late(self, step: Encounter) -> Bool[Tensor, "*b"]:
        """The clock after the step has reached the limit."""
        return step.time + step.dt_s >= self.limit_s - ROUNDING_S


VERDICTS: dict[str, Callable[[float], Verdict]] = {
    "crowdnav": CrowdNavVerdict,
    "exact": ExactVerdict,
}


def verdict_named(name: str, limit_s: float) -> Verdict:
    """The verdict of this name with a time limit in s.

    Raises:
        ValueError: There is no such verdict, or the limit does not fit it.
    """
    require_one_of("verdict", name, tuple(VERDICTS))
    return VERDICTS[name](limit_s)
