"""Checks of what a stack is asked to decide for: one message in place of an error from within."""

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from torch import Tensor

from diffstack_mmv.checks import message, require
from dmmv_conventions.observed import ObservedAgents

TEXTS = ("names", "modes")
ARRAYS = ("extent", "position", "velocity", "heading")


def require_observed(observed: object) -> None:
    """Refuse what are no observed agents, or some whose parts do not belong together.

    Raises:
        TypeError: It is something else, or a part is no array of numbers or no tuple of text.
        ValueError: Nobody is observed, or a shape is that of other agents or rows.
    """
    if not isinstance(observed, ObservedAgents):
        remedy = "Take what LiveTracks returns, or fill dmmv_conventions.observed.ObservedAgents."
        raise _wrong_type("observed", "be ObservedAgents", observed, remedy)
    for name in TEXTS:
        part = getattr(observed, name)
        if not (isinstance(part, (tuple, list)) and all(isinstance(each, str) for each in part)):
            raise TypeError(message(f"observed.{name}", "be a tuple of text", repr(part)))
    for name in ARRAYS:
        _require_numbers(f"observed.{name}", getattr(observed, name))
    _require_shapes(observed)


def _wrong_type(argument: str, requirement: str, value: object, remedy: str) -> TypeError:
    return TypeError(message(argument, requirement, type(value).__name__, "", remedy))


def _require_numbers(argument: str, value: object) -> None:
    needs = "be an array of numbers"
    if not isinstance(value, np.ndarray):
        raise _wrong_type(argument, needs, value, "Write np.asarray(...) around it.")
    if value.dtype.kind not in "fiu":
        remedy = "Write .astype(float) behind it."
        raise TypeError(message(argument, needs, f"one of {value.dtype}", "", remedy))


def _require_shapes(observed: ObservedAgents) -> None:
    count = len(observed.names)
    require(count > 0, "observed", "hold the ego", "no agent")
    flat, found = observed.heading.ndim == 2, observed.heading.shape
    require(flat, "observed.heading", f"have the shape ({count}, rows)", found)
    rows = observed.heading.shape[1]
    for name, last in (("position", (2,)), ("velocity", (2,)), ("heading", ())):
        found, wanted = getattr(observed, name).shape, (count, rows, *last)
        require(found == wanted, f"observed.{name}", f"have the shape {wanted}", found)
    told = (len(observed.modes), tuple(observed.extent.shape))
    wanted = (count, (count, 2))
    require(told == wanted, "observed.modes, extent", f"be of {count} agents", told)


def require_known_now(observed: ObservedAgents) -> None:
    """Refuse an ego that is absent now, and agents of which more than their position is needed.

    Raises:
        ValueError: The ego is not observed now, or somebody who is has no size, velocity or
            heading.
    """
    place, velocity, heading = (
        np.isfinite(part.reshape(len(part), -1)).all(-1)
        for part in (observed.position[:, -1], observed.velocity[:, -1], observed.heading[:, -1])
    )
    known = bool(place[0] and velocity[0] and heading[0])
    require(known, "ego", "be observed now", "NaN", f"for agent {observed.names[0]!r}")
    remedy = "Give it, or NaN for the position as well, and the agent is absent."
    for name, there in (("velocity", velocity), ("heading", heading)):
        now = getattr(observed, name)[:, -1]
        needs = "be finite now as the position is"
        _require_of_each(observed, name, needs, place & ~there, now, remedy)
    sized = np.isfinite(observed.extent).all(-1) & (observed.extent > 0).all(-1)
    remedy = "Give length and width in m, those usual for the mode where they are not measured."
    _require_of_each(observed, "extent", "be positive", place & ~sized, observed.extent, remedy)


def _require_of_each(
    observed: ObservedAgents,
    name: str,
    requirement: str,
    bad: Bool[np.ndarray, " n"],
    found: NDArray[np.float64],
    remedy: str,
) -> None:
    if bad.any():
        who = int(bad.argmax())
        where = f"for agent {observed.names[who]!r}"
        text = message(f"observed.{name}", requirement, found[who].tolist(), where, remedy)
        raise ValueError(text)


def point_of(goal: object) -> Float[Tensor, " 2"]:
    """A goal as x and y in m, on the CPU.

    Raises:
        ValueError: It is no point of two finite numbers.
    """
    try:
        point = torch.as_tensor(goal, dtype=torch.float64, device="cpu")
        fits = point.shape == (2,) and bool(point.isfinite().all())
    except (TypeError, ValueError, RuntimeError):  # what no numbers are made of
        fits = False
    require(fits, "goal", "be x and y in m", repr(goal))
    return point
