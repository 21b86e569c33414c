"""Clearance between a moving robot and moving discs, for the footprints a robot can have."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.checks import require_positive
from diffstack_mmv.geometry import distance_to_segment, length, rotate, unit_vector
from diffstack_mmv.types import Discs


class Approach(NamedTuple):
    """Straight relative motion of discs, seen from the centre of the robot in world directions."""

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
        """Radius in m of the smallest disc around the centre that holds the outline."""
        ...

    def clearance(self, approach: Approach) -> Float[Tensor, "*b"]:
        """Smallest clearance in m during the approach, negative for an overlap."""
        ...

    def discs(self) -> Discs:
        """Discs that cover the outline, m."""
        ...

    def outline(self) -> Float[Tensor, "corners 2"]:
        """Polygon around the centre in m, x forward, y left."""
        ...


@dataclass(frozen=True)
class DiscFootprint:
    """A disc around the centre of the robot, as in the benchmark.

    Attributes:
        radius_m: Radius.

    Raises:
        ValueError: The radius is not positive.
    """

    radius_m: float = 0.3

    def __post_init__(self) -> None:
        """Check the size once, at the border."""
        require_positive("radius_m", self.radius_m)

    def clearance(self, approach: Approach) -> Float[Tensor, "*b"]:
        """Smallest distance in m of two discs, exact for straight relative motion."""
        distance = distance_to_segment(approach.start, approach.end)
        return distance - approach.radius - self.radius_m

    def discs(self) -> Discs:
        """The disc itself."""
        return Discs(torch.zeros(1), torch.full((1,), self.radius_m, dtype=torch.float64))

    def outline(self) -> Float[Tensor, "corners 2"]:
        """Polygon of 48 corners on the circle, m."""
        return self.radius_m * unit_vector(torch.linspace(0, 2 * torch.pi, 49)[:-1].double())


@dataclass(frozen=True)
class RectangleFootprint:
    """A rectangle that turns with the robot, its centre at the centre of the robot.

    Attributes:
        length_m: Size along the heading.
        width_m: Size across the heading.

    Raises:
        ValueError: A size is not positive.
    """

    length_m: float
    width_m: float

    def __post_init__(self) -> None:
        """Check the sizes once, at the border."""
        require_positive("length_m", self.length_m)
        require_positive("width_m", self.width_m)

    @property
    def radius_m(self) -> float:
        """Half of the diagonal in m."""
        return 0.5 * (self.length_m**2 + self.width_m**2) ** 0.5

    def clearance(self, approach: Approach) -> Float[Tensor, "*b"]:
        """Distance in m from the rectangle to the discs; minus their radius for centres inside it.

        In the frame of the robot a disc moves straight where the heading stays constant; a turn
        during one fine step bends its path by less than its length times the angle turned.
        """
        start = rotate(approach.start, -approach.start_heading)
        end = rotate(approach.end, -approach.end_heading)
        half = start.new_tensor((0.5 * self.length_m, 0.5 * self.width_m))
        return distance_box_to_segment(half, start, end) - approach.radius

    def outline(self) -> Float[Tensor, "corners 2"]:
        """The four corners in m, counter-clockwise from the front left."""
        half = torch.tensor((0.5 * self.length_m, 0.5 * self.width_m), dtype=torch.float64)
        return half * half.new_tensor(((1, 1), (-1, 1), (-1, -1), (1, -1)))


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
