"""Constraints on states and controls as a user states them, and as the solver sees them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.checks import message, require, require_callable, require_tensor
from diffstack_mmv.control.expansion import pad_controls
from diffstack_mmv.control.fitting import require_fitting_constraint, untouched
from diffstack_mmv.control.optimizer import ConstraintFunction, Constraints
from diffstack_mmv.control.selection import Selectable


@dataclass(frozen=True)
class Slack:
    """Price of a violation s: `linear` · s + ½ `quadratic` · s².

    A linear price above the multiplier of the hard constraint leaves no violation where that can
    be met. Both may be tensors that require a gradient, of a shape that broadcasts against the
    values of the constraint (*b T+1 k).
    """

    linear: float | Tensor = 0.0
    quadratic: float | Tensor = 0.0


HARD = Slack(math.inf)


@dataclass(frozen=True)
class Inequality:
    """g(x_t, u_t) ≤ 0; where g is minus infinity there is no limit.

    Args:
        function: Gives the values of g.
        slack: Price of a violation; `HARD` if there must be none.
        times: The times of 0 .. T at which it holds: `slice(1, None)` leaves out the given start,
            `slice(-1, None)` is the end alone, `slice(-1)` leaves it out, where controls are zero.
    """

    function: ConstraintFunction
    slack: Slack = HARD
    times: slice = field(default_factory=lambda: slice(None))


@dataclass(frozen=True)
class Equality:
    """h(x_t, u_t) = 0; the arguments are those of `Inequality`."""

    function: ConstraintFunction
    slack: Slack = HARD
    times: slice = field(default_factory=lambda: slice(None))


Constraint = Inequality | Equality


def listed(constraints: Constraints) -> list[Constraint]:
    """A hard constraint for each function of a record.

    Raises:
        TypeError: It is no record.
    """
    if not isinstance(constraints, Constraints):
        remedy = "Write Constraints(inequality=g, equality=h)."
        found = type(constraints).__name__
        raise TypeError(message("constraints", "be Constraints", found, "", remedy))
    both: list[Constraint] = []
    if constraints.inequality is not None:
        both.append(Inequality(constraints.inequality))
    if constraints.equality is not None:
        both.append(Equality(constraints.equality))
    return both


class ConstraintRows(NamedTuple):
    """All constraints side by side: K values at each time.

    A multiplier is at most `linear` and grows beyond it only by `quadratic` times the violation.
    A hard row has an infinite `linear`.
    """

    functions: tuple[ConstraintFunction, ...]
    linear: Float[Tensor, "*b T1 K"]
    quadratic: Float[Tensor, "*b T1 K"]
    signed: Bool[Tensor, " K"]  # equalities, whose multiplier has either sign
    applies: Bool[Tensor, "T1 K"]  # times at which a constraint holds
    widths: tuple[int, ...]  # how many of the K belong to each constraint
    asked: tuple[Int[Tensor, " T1"], ...]  # at which time each function is asked instead of each

    def values(
        self, states: Float[Tensor, "*b T1 n"], controls: Float[Tensor, "*b T1 m"]
    ) -> Float[Tensor, "*b T1 K"]:
        """Values of all constraints, zero where they do not apply.

        There a function is asked at a time at which it does: zero times a derivative that is not
        finite, such as that of the length of no control at the end, would not be zero.
        """
        values = [
            function(states[..., at, :], controls[..., at, :])
            for function, at in zip(self.functions, self.asked, strict=True)
        ]
        return torch.where(self.applies, torch.cat(values, -1), 0.0)

    @property
    def signed_functions(self) -> list[bool]:
        """Which constraints are equalities."""
        return [bool(part.any()) for part in self.signed.split(list(self.widths))]

    def select(self, index: Int[Tensor, " k"]) -> "ConstraintRows":
        """The rows of some problems; all functions have to be selectable."""
        functions = tuple(
            part.select(index) for part in self.functions if isinstance(part, Selectable)
        )
        return self._replace(
            functions=functions, linear=self.linear[index], quadratic=self.quadratic[index]
        )

    def excess(self, values: Float[Tensor, "*b T1 K"]) -> Float[Tensor, "*b T1 K"]:
        """By how much each row is violated."""
        return torch.where(self.signed, values.abs(), values.clamp_min(0))

    def violation(self, values: Float[Tensor, "*b T1 K"]) -> Float[Tensor, "*b"]:
        """Largest violation of a hard row."""
        above = self.excess(values)
        hard = self.linear.isinf() & self.applies
        return torch.where(hard, above, torch.zeros_like(above)).amax((-2, -1))

    def paid(self, slack: Float[Tensor, "*b T1 K"]) -> Float[Tensor, "*b"]:
        """Price of the violations of soft rows."""
        linear = torch.where(self.linear.isfinite(), self.linear, torch.zeros_like(slack))
        return (linear * slack + 0.5 * self.quadratic * slack.square()).sum((-2, -1))


def gather(
    constraints: Sequence[Constraint],
    states: Float[Tensor, "*b T1 n"],
    controls: Float[Tensor, "*b T m"],
) -> ConstraintRows:
    """Lay constraints out as rows, their sizes taken from the values along a trajectory.

    Raises:
        ValueError: A constraint function does not return one row per time, or one that looks at
            other times, or writes into its arguments, or holds at none, or a price does not
            broadcast or is negative, or that of squares infinite.
        TypeError: A price is no number, or a slice of times is not one of whole numbers.
    """
    acting, parts, asked = pad_controls(controls), [], []
    for number, constraint in enumerate(constraints):
        name = f"constraints[{number}]"
        values = untouched(name, constraint.function, states, acting)
        require_tensor(f"{name}(states, controls)", values)
        require(
            values.shape[:-1] == states.shape[:-1],
            name,
            f"return values of shape ({', '.join(map(str, states.shape[:-1]))}, k)",
            tuple(values.shape),
        )
        require_fitting_constraint(name, constraint.function, states, acting, values)
        applies = torch.zeros(values.shape[-2:], dtype=torch.bool, device=values.device)
        chosen = _times(f"{name}.times", constraint.times, len(applies))
        applies[list(chosen)] = True
        asked.append([time if time in chosen else chosen[0] for time in range(len(applies))])
        linear, quadratic = (
            _priced(price, values, applies, f"{name}.slack.{which}")
            for which, price in vars(constraint.slack).items()
        )
        signed = torch.full_like(applies[0], isinstance(constraint, Equality))
        parts.append((linear, quadratic, signed, applies))
    columns = (torch.cat(part, -1) for part in zip(*parts, strict=True))
    widths = tuple(applies.shape[1] for *_, applies in parts)
    functions = tuple(constraint.function for constraint in constraints)
    at = tuple(torch.tensor(times, device=states.device) for times in asked)
    return ConstraintRows(*[functions, *columns, widths, at])


def require_constraints(constraints: object) -> None:
    """Refuse what is no sequence of constraints, each with a function, a `Slack` and a slice.

    Raises:
        TypeError: It is another thing, or a part of it is.
    """
    if not isinstance(constraints, Sequence):
        remedy = "Write a list: [Inequality(g), Equality(h)]."
        found = type(constraints).__name__
        raise TypeError(message("constraints", "be a sequence", found, "", remedy))
    for number, constraint in enumerate(constraints):
        name = f"constraints[{number}]"
        remedy = "Write Inequality(function) or Equality(function)."
        _require_kind(name, constraint, "an Inequality or an Equality", Constraint, remedy)
        remedy = "Write Slack(linear=...)."
        _require_kind(f"{name}.slack", constraint.slack, "a Slack", Slack, remedy)
        require_callable(f"{name}.function", constraint.function)
        remedy = "Write slice(t, t + 1) for one time t, slice(-1, None) for the end."
        _require_kind(f"{name}.times", constraint.times, "a slice", slice, remedy)


def _times(name: str, times: slice, count: int) -> range:
    """The chosen ones of 0 .. T; with none of them the constraint would hold nowhere."""
    try:
        chosen = range(count)[times]
    except (TypeError, ValueError) as unable:
        raise type(unable)(message(name, "be a slice of whole numbers", times)) from None
    require(len(chosen) > 0, name, f"choose at least one of the times 0 .. {count - 1}", times)
    return chosen


def _require_kind(name: str, value: object, wanted: str, kind: Any, remedy: str) -> None:
    if not isinstance(value, kind):
        raise TypeError(message(name, f"be {wanted}", type(value).__name__, "", remedy))


def _require_all(fits: Tensor, given: Tensor, name: str, wanted: str, remedy: str = "") -> None:
    """Refuse numbers by the first one that does not fit: all would be a page."""
    if not bool(fits.all()):
        raise ValueError(message(name, wanted, float(given[~fits][0]), "", remedy))


def _priced(price: float | Tensor, values: Tensor, applies: Tensor, name: str) -> Tensor:
    try:
        given = torch.as_tensor(price, dtype=values.dtype, device=values.device)
    except (TypeError, ValueError):
        raise TypeError(message(name, "be a number or a tensor", repr(price))) from None
    _require_all(given >= 0, given, name, "be zero or positive")
    if name.endswith("quadratic"):
        remedy = "A violation without a price that it could pay is that of Slack(math.inf)."
        _require_all(given.isfinite(), given, name, "be finite", remedy)
    try:
        whole = given.expand(values.shape)
    except RuntimeError:
        shape = tuple(values.shape)
        raise ValueError(message(name, f"broadcast to {shape}", tuple(given.shape))) from None
    return torch.where(applies, whole, torch.zeros_like(whole))
