"""What a controller gets to know of the world."""

from typing import Any, NamedTuple, Protocol, runtime_checkable

from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.simulation.pedestrians import PedestrianHistory
from diffstack_mmv.types import Discs, Motion, map_tensors


class Observation(NamedTuple):
    """What a controller may know: the robot, and the pedestrians without their goals."""

    motion: Motion  # *b, of the robot's centre
    velocity: Float[Tensor, "*b 2"]  # m/s, of the robot in world directions
    radius: Float[Tensor, "*b"]  # m, of the disc around the robot's reference point that holds it
    discs: Discs  # *b D, that cover the robot
    goal: Float[Tensor, "*b 2"]  # m
    pedestrian_position: Float[Tensor, "*b h 2"]  # m
    pedestrian_velocity: Float[Tensor, "*b h 2"]  # m/s
    pedestrian_radius: Float[Tensor, "*b h"]  # m
    seen: Bool[Tensor, "*b h"]  # the hidden are laid far away and ignored
    time: Float[Tensor, "*b"]  # s
    case: Int[Tensor, "*b"]  # numbers draws of noise; nothing to decide by
    running: Bool[Tensor, "*b"]  # false where the episode has ended and its action counts no more
    history: PedestrianHistory | None = None  # of the pedestrians, before the start
    # *b h T 2 in m, one row per step of the world, where the world reveals it; never a controller's
    future: Float[Tensor, "*b h T 2"] | None = None


@runtime_checkable
class Sensing(Protocol):
    """What a robot sees of an observation, which holds the truth."""

    def __call__(self, observation: Observation) -> Observation:
        """The observation with what is hidden or disturbed."""
        ...


def in_precision_of(like: Tensor, record: Any) -> Any:
    """A record whose real numbers have type and device of a tensor; all else stays."""
    return map_tensors(lambda each: each.to(like) if each.is_floating_point() else each, record)
