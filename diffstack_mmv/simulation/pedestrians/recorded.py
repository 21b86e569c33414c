"""A crowd that carries its recording with it."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.checks import message
from diffstack_mmv.simulation.pedestrians.base import CrowdState, PedestrianHistory

ABSENT_M = 1e3
"""Where who is absent is kept: too far away for anything to happen to anybody."""
ABSENT_APART_M = 20.0


class RecordedCrowdState(NamedTuple):
    """A crowd with its recording, whose rows are as far apart as the steps of the world.

    The first five fields are those of `CrowdState`. `track` and `inside` hold the whole recording,
    past and future; only `position`, `velocity`, `present` and `history` are there to be seen.
    """

    position: Float[Tensor, "*b h 2"]  # m
    velocity: Float[Tensor, "*b h 2"]  # m/s, over the step before: nothing of the future is in it
    goal: Float[Tensor, "*b h 2"]  # m, where the recording of each ends
    radius: Float[Tensor, "*b h"]  # m
    preferred_speed: Float[Tensor, "*b h"]  # m/s, of the recording
    track: Float[Tensor, "*b h R 2"]  # m
    inside: Bool[Tensor, "*b h R"]  # recorded in this row and in the one before
    row: Int[Tensor, "*b"]  # the present
    lead: Int[Tensor, "*b"]  # the row in which the episodes begin
    step_s: Float[Tensor, "*b"]  # from one row to the next

    @property
    def present(self) -> Bool[Tensor, "*b h"]:
        """Who is there now."""
        return self.inside_after(0)

    def recorded(self, ahead: int) -> Float[Tensor, "*b h 2"]:
        """Recorded positions in m so many rows from now."""
        row = (self.row + ahead).clamp(0, self.track.shape[-2] - 1)
        return self.track.take_along_dim(row[..., None, None, None], -2).squeeze(-2)

    def inside_after(self, ahead: int) -> Bool[Tensor, "*b h"]:
        """Who is there so many rows from now."""
        row = self.row + ahead
        rows = self.inside.shape[-1]
        within = self.inside.take_along_dim(row.clamp(0, rows - 1)[..., None, None], -1)
        return within.squeeze(-1) & (row < rows)[..., None]

    def stays(self) -> Bool[Tensor, "*b h"]:
        """Who is there now and after the step to come."""
        return self.present & self.inside_after(1)

    def moved(self, velocity: Float[Tensor, "*b h 2"], dt_s: float) -> "RecordedCrowdState":
        """The crowd after a step at `velocity` (m/s); who appears is where it was recorded."""
        stays, after = self.stays()[..., None], self.inside_after(1)[..., None]
        entered = self.recorded(1)
        position = torch.where(stays, self.position + velocity * dt_s, entered)
        known = torch.where(stays, velocity, (entered - self.recorded(0)) / dt_s)
        return self._replace(
            position=torch.where(after, position, far_away(position)),
            velocity=torch.where(after, known, torch.zeros_like(known)),
            row=self.row + 1,
        )

    def history(self) -> PedestrianHistory:
        """What was recorded before the episodes began, which is the same in all of their steps.

        Raises:
            ValueError: The episodes do not begin in the same row.
        """
        first = int(self.lead.reshape(-1)[0])
        if not bool((self.lead == first).all()):
            told = f"from {int(self.lead.min())} to {int(self.lead.max())}"
            raise ValueError(message("lead", "be the same in all episodes", told))
        step_s = float(self.step_s.reshape(-1)[0])
        inside = self.inside[..., :first]
        position = self.track[..., :first, :]
        before = torch.cat((position[..., :1, :], position[..., :-1, :]), -2)[..., :first, :]
        velocity = (position - before) / step_s
        seen = inside[..., None]
        nothing = torch.zeros_like(position)
        return PedestrianHistory(
            position=torch.where(seen, position, nothing),
            velocity=torch.where(seen, velocity, nothing),
            present=inside,
            step_s=step_s,
        )

    def future(self, steps: int) -> Float[Tensor, "*b h T 2"]:
        """Recorded positions in m of the steps to come; who leaves stays where it was last."""
        rows = [self.position]
        for ahead in range(1, steps + 1):
            inside = self.inside_after(ahead)[..., None]
            rows.append(torch.where(inside, self.recorded(ahead), rows[-1]))
        return torch.stack(rows[1:], -2)


def far_away(like: Float[Tensor, "*b h 2"]) -> Float[Tensor, "*b h 2"]:
    """Places in m for those who are absent, apart from each other."""
    number = torch.arange(like.shape[-2], dtype=like.dtype, device=like.device)
    place = torch.stack((ABSENT_M + ABSENT_APART_M * number, torch.full_like(number, ABSENT_M)), -1)
    return place.expand_as(like)


AnyCrowdState = CrowdState | RecordedCrowdState
