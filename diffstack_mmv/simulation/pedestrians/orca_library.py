"""ORCA as a library in C++, agent by agent: a hundredth of the time for a single episode.

The arithmetic is that of the tensors, bit by bit, so that nothing depends on whether there is a
compiler.
"""

import ctypes
import functools
from collections.abc import Sequence
from importlib.resources import files
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch._functorch import pyfunctorch

from diffstack_mmv.simulation.pedestrians.base import CrowdState, VisibleRobot
from diffstack_mmv.types import on_host
from dmmv_conventions.libraries import REALS, counts, load_or_tell, pointers


class Rolled(NamedTuple):
    """A crowd after 1 .. T steps."""

    position: Float[Tensor, "*b h T 2"]  # m
    velocity: Float[Tensor, "*b h T 2"]  # m/s


class Rules(ctypes.Structure):
    """The settings of ORCA as the library reads them."""

    _fields_ = (
        ("distance_m", ctypes.c_float),
        ("horizon_s", ctypes.c_float),
        ("step_s", ctypes.c_float),
        ("most", ctypes.c_int),
    )


@functools.cache
def library() -> Any | None:
    """The library, None without a compiler."""
    source = files("diffstack_mmv.simulation.pedestrians").joinpath("orca.hpp").read_text()
    return load_or_tell("ORCA", source, "-ffp-contract=off")


def is_possible(
    crowd: CrowdState, robot: VisibleRobot | None = None, goals: Tensor | None = None
) -> bool:
    """Whether the library can read these, and is there.

    It reads one number after the other: what only fits by broadcasting is left to tensors.
    """
    others = [] if goals is None else [goals]
    tensors, like = [*crowd, *(robot or ()), *others], crowd.position
    if not _fit(crowd, robot, goals):
        return False
    plain = like.dtype in REALS and not torch.compiler.is_compiling()
    if not plain or pyfunctorch.retrieve_all_functorch_interpreters():
        return False
    same = on_host(*tensors) and all(each.dtype == like.dtype for each in tensors)
    return same and library() is not None


def _fit(crowd: CrowdState, robot: VisibleRobot | None, goals: Tensor | None) -> bool:
    """Whether there is one number of each kind for each pedestrian, and for each episode."""
    position, velocity, goal, radius, speed = crowd[:5]  # of a recording there are more
    people, places = radius.shape, position.shape
    fits = velocity.shape == goal.shape == places == (*people, 2) and speed.shape == people
    if robot is not None:
        episodes, seen = people[:-1], robot.position.shape
        fits = fits and robot.velocity.shape == seen == (*episodes, 2)
        fits = fits and robot.radius.shape == episodes
    if goals is not None:
        fits = fits and goals.shape == (*people, *goals.shape[-2:-1], 2)
    return fits


def roll(
    crowd: CrowdState,
    rules: Rules,
    margin_m: float,
    dt_s: float,
    steps: int,
    robot: VisibleRobot | None = None,
) -> Rolled:
    """The crowd after 1 .. `steps` steps; the robot, where it is seen, stays where it is."""
    (*batch, h), like = crowd.radius.shape, crowd.position
    given = _contiguous((*crowd, *(robot or ())))
    position, velocity = like.new_empty(2, *batch, h, steps, 2)
    addresses = pointers(*given) + [None] * (8 - len(given))
    call = getattr(library(), f"orca_roll_{REALS[like.dtype]}")
    sizes = *counts(crowd.radius[..., 0].numel()), h, steps
    numbers = ctypes.c_double(dt_s), ctypes.c_double(margin_m), ctypes.byref(rules)
    call(*sizes, *numbers, *addresses, *pointers(position, velocity))
    return Rolled(position, velocity)


def respond(
    crowd: CrowdState, rules: Rules, margin_m: float, goals: Float[Tensor, "*b h k 2"]
) -> Float[Tensor, "*b h k 2"]:
    """Velocity in m/s of each pedestrian for each of its goals (m)."""
    (*_, h, k, _), result = (
        goals.shape,
        torch.empty_like(goals, memory_format=torch.contiguous_format),
    )
    fields = crowd.position, crowd.velocity, crowd.radius, crowd.preferred_speed, goals
    given = _contiguous(fields)
    call = getattr(library(), f"orca_respond_{REALS[goals.dtype]}")
    sizes = *counts(crowd.radius[..., 0].numel()), h, k
    call(*sizes, ctypes.c_double(margin_m), ctypes.byref(rules), *pointers(*given, result))
    return result


def _contiguous(tensors: Sequence[Tensor]) -> list[Tensor]:
    return [each.detach().contiguous() for each in tensors]
