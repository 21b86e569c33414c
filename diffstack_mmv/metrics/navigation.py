"""Scores of closed-loop episodes: how often, how fast and how far from pedestrians."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require, require_positive
from diffstack_mmv.geometry import rotate
from diffstack_mmv.types import EpisodeRecord, Outcome

DISCOMFORT_M = 0.2
"""Clearance below which a pedestrian feels uncomfortable (Chen et al., Crowd-Robot Interaction)."""
NORMAL_QUANTILE = 1.959963984540054
"""Standard normal quantile of a two-sided interval of 95 %."""


class Interval(NamedTuple):
    """A share with its interval of confidence."""

    low: Float[Tensor, "*b"]
    high: Float[Tensor, "*b"]


def wilson_interval(
    hits: Float[Tensor, "*b"], total: Float[Tensor, "*b"], quantile: float = NORMAL_QUANTILE
) -> Interval:
    """Interval of confidence of a share, sound also for shares of 0 and 1 and for few cases.

    (p + z²/2n ± z sqrt(p (1 - p)/n + z²/4n²)) / (1 + z²/n) with p = hits/n and n = total.

    Args:
        hits: Number of cases with the property.
        total: Number of cases.
        quantile: z, the default gives 95 %.

    Returns:
        Lower and upper end, dimensionless, NaN without cases.

    Raises:
        ValueError: The quantile is not positive.

    Source:
        Wilson, Probable inference, the law of succession, and statistical inference (1927).
    """
    require_positive("quantile", quantile)
    share = hits / total
    spread = quantile * torch.sqrt(share * (1 - share) / total + (quantile / (2 * total)) ** 2)
    middle = share + quantile**2 / (2 * total)
    scale = 1 + quantile**2 / total
    low, high = (middle - spread) / scale, (middle + spread) / scale
    # the ends 0 and 1 are exact, which rounding is not
    return Interval(
        low.clamp(min=0).masked_fill(share == 0, 0.0),
        high.clamp(max=1).masked_fill(share == 1, 1.0),
    )


def uneasy_steps(record: EpisodeRecord) -> Bool[Tensor, "E T1"]:
    """Steps in which a pedestrian feels uncomfortable: clearance in [0, 0.2 m).

    The step that ends an episode counts as collision, success or time-out instead, as in the
    original benchmark.
    """
    row = torch.arange(record.clearance.shape[1], device=record.clearance.device)
    during = (row > 0) & (row < record.steps[:, None])
    return during & (record.clearance >= 0) & (record.clearance < DISCOMFORT_M)


class Ride(NamedTuple):
    """How comfortable episodes were to ride in; means over the square are taken per episode."""

    acceleration: Float[Tensor, " E"]  # m/s², root mean square of the steps
    jerk: Float[Tensor, " E"]  # m/s³


def ride(record: EpisodeRecord) -> Ride:
    """Root mean squares of the acceleration of the steps, and of its change from step to step.

    Both are those of the velocity in the plane, so that braking and bends count alike.
    """
    velocity = rotate(record.motion.velocity, record.motion.heading)
    acceleration = velocity.diff(dim=-2) / record.dt_s
    jerk = acceleration.diff(dim=-2) / record.dt_s
    row = torch.arange(acceleration.shape[-2], device=acceleration.device)
    driven = row < record.steps[:, None]

    def effective(vectors: Float[Tensor, "E T 2"], counts: Bool[Tensor, "E T"]) -> Tensor:
        squared = vectors.square().sum(-1) * counts
        return (squared.sum(-1) / counts.sum(-1).clamp(min=1)).sqrt()

    return Ride(effective(acceleration, driven), effective(jerk, driven[:, 1:]))


class EpisodeMean(ABC):
    """Quotient of two sums over episodes; a subclass says which.

    Titles, units and which sign is better stand in `scores.CLOSED_LOOP`.
    """

    def __init__(self) -> None:
        self.total = torch.zeros((), dtype=torch.float64)
        self.weight = torch.zeros((), dtype=torch.float64)

    def merge_state(self, other: "EpisodeMean") -> None:
        """Add what the same score has counted elsewhere.

        Raises:
            ValueError: It is another score.
        """
        same = type(other) is type(self)
        require(same, "other", f"be a {type(self).__name__}", type(other).__name__)
        self.total += other.total
        self.weight += other.weight

    def update(self, record: EpisodeRecord) -> None:
        """Add the episodes of a record.

        Raises:
            ValueError: An episode has not ended.
        """
        unfinished = int((record.outcome < Outcome.COLLISION).sum())
        found = f"{unfinished} that still run"
        require(not unfinished, "record", "hold ended episodes only", found)
        self.total += self._values(record).double().sum()
        self.weight += self._weights(record).double().sum()

    def compute(self) -> Float[Tensor, ""]:
        """The quotient in the unit of the score; NaN where nothing was counted."""
        return self.total / self.weight

    @abstractmethod
    def _values(self, record: EpisodeRecord) -> Tensor:
        """What is summed in the numerator."""

    def _weights(self, record: EpisodeRecord) -> Tensor:
        """What is summed in the denominator: episodes, unless a subclass says otherwise."""
        return torch.ones_like(record.outcome)


class OutcomeRate(EpisodeMean):
    """Share of the episodes with one outcome."""

    outcome: Outcome

    def _values(self, record: EpisodeRecord) -> Tensor:
        return record.outcome == self.outcome

    def interval(self) -> Interval:
        """Wilson interval of 95 %, dimensionless."""
        return wilson_interval(self.total, self.weight)


class SuccessRate(OutcomeRate):
    """Share of the episodes that reached the goal."""

    outcome = Outcome.SUCCESS


class CollisionRate(OutcomeRate):
    """Share of the episodes that ended in a collision."""

    outcome = Outcome.COLLISION


class IncompleteRate(OutcomeRate):
    """Share of the episodes that ran out of time."""

    outcome = Outcome.TIMEOUT


class NavigationTime(EpisodeMean):
    """Mean time of the successful episodes; NaN without a success."""

    def _values(self, record: EpisodeRecord) -> Tensor:
        return torch.where(record.outcome == Outcome.SUCCESS, record.duration, 0)

    def _weights(self, record: EpisodeRecord) -> Tensor:
        return record.outcome == Outcome.SUCCESS


class NavigationTimeOfAll(EpisodeMean):
    """Mean time of all episodes: to the goal, to the collision, or the limit."""

    def _values(self, record: EpisodeRecord) -> Tensor:
        return record.duration


class DiscomfortFrequency(EpisodeMean):
    """Share of the `uneasy_steps` among all steps; time-outs count up to the limit."""

    def _values(self, record: EpisodeRecord) -> Tensor:
        return uneasy_steps(record)

    def _weights(self, record: EpisodeRecord) -> Tensor:
        return record.duration / record.dt_s


class DiscomfortDistance(EpisodeMean):
    """Mean clearance over the `uneasy_steps`, below 0.2 m by construction; NaN without any."""

    def _values(self, record: EpisodeRecord) -> Tensor:
        return torch.where(uneasy_steps(record), record.clearance, 0)

    def _weights(self, record: EpisodeRecord) -> Tensor:
        return uneasy_steps(record)


class EpisodeMinimumDistance(EpisodeMean):
    """Mean of the smallest clearance, an overlap counting as zero, over episodes with anybody."""

    def _values(self, record: EpisodeRecord) -> Tensor:
        return record.clearance.amin(dim=1).clamp(min=0).nan_to_num(posinf=0)

    def _weights(self, record: EpisodeRecord) -> Tensor:
        return record.clearance.amin(dim=1).isfinite()


class RideAcceleration(EpisodeMean):
    """Mean over the episodes of the root mean square of the acceleration, see `ride`."""

    def _values(self, record: EpisodeRecord) -> Tensor:
        return ride(record).acceleration


class RideJerk(EpisodeMean):
    """Mean over the episodes of the root mean square of the jerk, see `ride`."""

    def _values(self, record: EpisodeRecord) -> Tensor:
        return ride(record).jerk
