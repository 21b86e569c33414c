"""Clearance, margins and risk of many plans in a library in C++: a tenth of the time of tensors."""

import ctypes
import functools
from dataclasses import fields
from importlib.resources import files
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.planning.clearance import ClearanceMargin, Safety
from diffstack_mmv.types import Discs, Motion, Obstacles, on_host
from dmmv_conventions.libraries import REALS, counts, load_or_tell, pointers

READ = tuple(field.name for field in fields(ClearanceMargin))
"""Of a margin, all of them numbers; the library is told their names."""


class Passing(NamedTuple):
    """How plans pass the agents, `*b C`."""

    safety: Safety
    risk: Float[Tensor, "*b C"]  # s, expected time of contact


class _Settings(ctypes.Structure):
    """What the library reads of a margin."""

    _fields_ = tuple((name, ctypes.c_double) for name in (*READ, "dt_s"))


@functools.cache
def library() -> Any | None:
    """The library, None without a compiler."""
    source = files("diffstack_mmv.planning").joinpath("judgement.hpp").read_text()
    told = f"#define MARGIN_FIELDS {', '.join(READ)}\n"
    return load_or_tell("clearances", told + source, "-O3")


def _fit(motion: Motion, discs: Discs, obstacles: Obstacles, driven: Tensor) -> bool:
    """Whether the sizes are those that the library takes from a few of them."""
    plans, agents = motion.position.shape, obstacles.weight.shape
    if len(plans) != 4 or len(agents) != 3 or not on_host(driven, obstacles.valid):
        return False
    fits = motion.heading.shape == plans[:-1] and plans[-1] == 2
    fits = fits and driven.shape == (*plans[:2], plans[2] - 1)
    fits = fits and obstacles.position.shape[1:] == (*agents[1:], plans[2], 2)
    fits = fits and obstacles.radius.shape[1:] == obstacles.valid.shape[1:] == agents[1:2]
    return fits and discs.ahead.shape[1:] == discs.radius.shape[1:] and discs.radius.dim() == 2


@torch.no_grad()
def judged(
    margin: ClearanceMargin,
    motion: Motion,
    discs: Discs,
    obstacles: Obstacles,
    driven: Bool[Tensor, "*b C T"],
    dt_s: float,
) -> Passing | None:
    """The judgement of a margin on plans, without gradients; None if there is no library for it.

    Equal to `ClearanceMargin` on `clearance_within_steps` but for rounding.

    Args:
        margin: What is asked.
        motion: Motions of the plans, `*b C T1`; a library wants one leading dimension, and all
            else of the sizes told here.
        discs: Around the vehicle, `b D`.
        obstacles: Agents, `b N K T1`.
        driven: Steps up to the arrival, the first of all; after them a plan meets nobody.
        dt_s: Time between two rows of a plan.
    """
    position, heading = motion.position, motion.heading
    given = position, heading, *discs, *obstacles[:3]
    like = position.dtype
    plain = like in REALS and on_host(*given) and all(e.dtype == like for e in given)
    plain = plain and _fit(motion, discs, obstacles, driven)
    if not plain or torch.compiler.is_compiling() or library() is None:
        return None
    problems, plans, rows, _ = position.shape
    _, count, components, *_ = obstacles.position.shape
    live = driven.sum(-1).to(like)
    wide = (
        each.expand(problems, *each.shape[1:]).contiguous()
        for each in (position, heading, live, *discs, *obstacles[:3], obstacles.valid)
    )
    told = position.new_empty(problems, plans, 3)
    settings = [getattr(margin, name) for name in READ]
    sizes = *counts(problems, plans), rows - 1, discs.radius.shape[-1]
    kept = list(wide)
    getattr(library(), f"judge_{REALS[like]}")(
        *(*sizes, count, components),
        ctypes.byref(_Settings(*settings, dt_s)),
        *pointers(*kept, told),
    )
    penalty, shortfall, risk = told.unbind(-1)
    # a clearance that is no number shows in the penalty, which is a sum
    safe = (shortfall == 0) & ~penalty.isnan()
    return Passing(Safety(safe, penalty, shortfall), risk)
