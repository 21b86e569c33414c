"""Clearance between a moving robot and moving discs, for the footprints a robot can have."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require, require_positive
from diffstack_mmv.geometry import distance_to_segment, length, rotate, unit_vector
from diffstack_mmv.types import Discs

MOST_DISCS = 5


class ClosestApproach(NamedTuple):
    """Straight relative motion of discs, seen from the reference point in world directions."""

    start: Float[Tensor, "*b 2"]  # m, disc minus robot
    end: Float[Tensor, "*b 2"]  # m
    radius: Float[Tensor, "*b"]  # m, of the disc
    start_heading: Float[Tensor, "*b"]  # rad, of the robot
    end_heading: Float[Tensor, "*b"]  # rad


@runtime_checkable
class Footprint(Protocol):
    """The outline of a robot."""

    @property
    def radius_m(self) -> float:
        """Radius in m of the smallest disc around the reference point that holds the outline."""
        ...

    def clearance(self, approach: ClosestApproach) -> Float[Tensor, "*b"]:
        """Smallest clearance in m during the approach, negative for an overlap."""
        ...

    def outline(self) -> Float[Tensor, "corners 2"]:
        """Polygon around the reference point in m, x forward, y left."""
        ...

    def discs(self) -> Discs:
        """Discs that cover the outline, in m along the heading."""
        ...

    def description(self) -> dict[str, Any]:
        """Shape and sizes in m, for a results file."""
        ...


@dataclass(frozen=True)
class DiscFootprint:
    """A disc around the reference point of the robot, as in the benchmark.

    Attributes:
        radius_m: Radius.

    Raises:
        ValueError: The radius is not positive.
    """

    radius_m: float = 0.3

    def __post_init__(self) -> None:
        """Check the size once, at the border."""
        require_positive("radius_m", self.radius_m)

    def clearance(self, approach: ClosestApproach) -> Float[Tensor, "*b"]:
        """Smallest distance in m of two discs, exact for straight relative motion."""
        distance = distance_to_segment(approach.start, approach.end)
        return distance - approach.radius - self.radius_m

    def outline(self) -> Float[Tensor, "corners 2"]:
        """Polygon of 48 corners on the circle, m."""
        return self.radius_m * unit_vector(torch.linspace(0, 2 * torch.pi, 49)[:-1].double())

    def discs(self) -> Discs:
        """The disc itself, m."""
        radius = torch.tensor([self.radius_m], dtype=torch.float64)
        return Discs(torch.zeros_like(radius), radius)

    def description(self) -> dict[str, Any]:
        """Shape and radius in m."""
        return {"shape": "disc", "radius_m": self.radius_m}


@dataclass(frozen=True)
class RectangleFootprint:
    """A rectangle that turns with the robot.

    Attributes:
        length_m: Size along the heading.
        width_m: Size across the heading.
        ahead_m: Distance of its centre ahead of the robot's reference point.

    Raises:
        ValueError: A size is not positive, or the distance not finite.
    """

    length_m: float
    width_m: float
    ahead_m: float = 0.0

    def __post_init__(self) -> None:
        """Check the sizes once, at the border."""
        require_positive("length_m", self.length_m)
        require_positive("width_m", self.width_m)
        require(math.isfinite(self.ahead_m), "ahead_m", "be finite", self.ahead_m)

    @property
    def radius_m(self) -> float:
        """Distance in m of the farthest corner from the reference point."""
        return math.hypot(0.5 * self.length_m + abs(self.ahead_m), 0.5 * self.width_m)

    def clearance(self, approach: ClosestApproach) -> Float[Tensor, "*b"]:
        """Distance in m from the rectangle to the discs; minus their radius for centres inside it.

        In the frame of the robot a disc moves straight where the heading stays constant; a turn
        during one fine step bends its path by less than its length times the angle turned.
        """
        middle = approach.start.new_tensor((self.ahead_m, 0.0))
        start = rotate(approach.start, -approach.start_heading) - middle
        end = rotate(approach.end, -approach.end_heading) - middle
        half = start.new_tensor((0.5 * self.length_m, 0.5 * self.width_m))
        return distance_box_to_segment(half, start, end) - approach.radius

    def outline(self) -> Float[Tensor, "corners 2"]:
        """The four corners in m, counter-clockwise from the front left."""
        half = torch.tensor((0.5 * self.length_m, 0.5 * self.width_m), dtype=torch.float64)
        corners = half * half.new_tensor(((1, 1), (-1, 1), (-1, -1), (1, -1)))
        return corners + half.new_tensor((self.ahead_m, 0.0))

    def discs(self) -> Discs:
        """The fewest equal discs on the axis whose overhang beside the rectangle is small, m.

        D discs cover the rectangle best where each covers a piece of length / D:

            radius = ½ sqrt((length / D)² + width²)

        D is the least number whose pieces are no longer than they are
        wide, so that a disc stands out sideways by at most (√2 - 1) / 2 = 21 % of the width; it is
        at most 5, and longer rectangles, longer than 5 widths, get wider discs.
        """
        wanted = math.ceil(self.length_m / self.width_m - 1e-9)
        count = min(max(wanted, 1), MOST_DISCS)
        piece = self.length_m / count
        radius = 0.5 * math.hypot(piece, self.width_m)
        place = torch.arange(count, dtype=torch.float64) - 0.5 * (count - 1)
        ahead = self.ahead_m + piece * place
        return Discs(ahead, torch.full_like(ahead, radius))

    def description(self) -> dict[str, Any]:
        """Shape, sizes and place in m."""
        sizes = {"length_m": self.length_m, "width_m": self.width_m, "ahead_m": self.ahead_m}
        return {"shape": "box"} | sizes


def distance_box_to_segment(
    half: Float[Tensor, " 2"], start: Float[Tensor, "*b 2"], end: Float[Tensor, "*b 2"]
) -> Float[Tensor, "*b"]:
    """Distance in m of the box |x| <= half to a segment, zero where they meet.

    Args:
        half: Half the size of the box in m.
        start: One end of the segment, m.
        end: The other end, m.

    Returns:
        Distance in m: the smallest of the box to the two ends and of its corners to the segment.
    """
    ends = torch.stack((start, end))
    outside = (ends.abs() - half).clamp(min=0)
    nearest = length(outside).amin(dim=0)
    for sign in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        corner = half * half.new_tensor(sign)
        nearest = torch.minimum(nearest, distance_to_segment(start - corner, end - corner))
    return torch.where(_meets_box(half, start, end), torch.zeros_like(nearest), nearest)


def _meets_box(
    half: Float[Tensor, " 2"], start: Float[Tensor, "*b 2"], end: Float[Tensor, "*b 2"]
) -> Bool[Tensor, "*b"]:
    """Whether a segment enters the box |x| <= half (m), clipped at the two pairs of sides."""
    way = end - start
    first, second = (-half - start) / way, (half - start) / way
    enter, leave = torch.minimum(first, second), torch.maximum(first, second)
    inside = start.abs() <= half
    still = way == 0
    enter = torch.where(still, torch.where(inside, -torch.inf, torch.inf), enter).amax(dim=-1)
    leave = torch.where(still, torch.where(inside, torch.inf, -torch.inf), leave).amin(dim=-1)
    return enter.clamp(min=0) <= leave.clamp(max=1)
