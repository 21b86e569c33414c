"""The outer iterations: where each problem stands, and its next multipliers and penalty."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.checks import require
from diffstack_mmv.control.constrained.augmented import next_multiplier
from diffstack_mmv.control.constrained.constraint import Rows
from diffstack_mmv.control.constrained.local import Problem, linearise_rows
from diffstack_mmv.control.expansion import expand_cost, pad_controls
from diffstack_mmv.control.iteration import OPEN
from diffstack_mmv.types import Solution, SolverStatus

PROGRESS = 0.25  # of the violation of the last iteration, above which the penalty grows
GROWTH = 10.0
MOST_GROWTH = 1e8  # of the penalty, over all iterations
LARGEST_MULTIPLIER = 1e8  # in units of the penalty times the constraint at the first iteration
NARROW = 1e-2  # gradient of a constraint relative to the steepest one, below which it counts as that


class Progress(NamedTuple):
    """Where each problem stands."""

    u: Float[Tensor, "*b T m"]
    multipliers: Float[Tensor, "*b T1 K"]
    penalty: Float[Tensor, "*b 1 K"]
    growth: Float[Tensor, "*b"]  # of the penalty so far
    error: Float[Tensor, "*b"]  # of the constraints and their multipliers, at the last iteration
    violation: Float[Tensor, "*b"]
    status: Int[Tensor, "*b"]
    iterations: Int[Tensor, "*b"]

    @property
    def is_open(self) -> Bool[Tensor, "*b"]:
        """Which problems are still being solved."""
        return self.status == OPEN

    def kept_where(self, done: Bool[Tensor, "*b"], other: "Progress") -> "Progress":
        """`other` where `done`, and this elsewhere."""
        pairs = zip(other, self, strict=True)
        return Progress(
            *(torch.where(done.view(*done.shape, *[1] * (new.dim() - done.dim())), new, old)
              for new, old in pairs)
        )


def begin(
    problem: Problem,
    x: Float[Tensor, "*b T1 n"],
    u: Float[Tensor, "*b T m"],
    multipliers: Sequence[Float[Tensor, "*b T1 k"]] | None,
    factor: float,
) -> Progress:
    """Progress at a guess, with multipliers of zero or the given ones.

    Raises:
        ValueError: The given multipliers do not fit the constraints.
    """
    rows = problem.rows
    guess = torch.zeros_like(rows.linear)
    if multipliers is not None:
        given = torch.cat(list(multipliers), -1).detach().to(guess)
        require(
            given.shape == guess.shape,
            "multipliers",
            f"have shape {tuple(guess.shape)} side by side",
            tuple(given.shape),
        )
        guess = torch.where(rows.applies, given, guess)
    zero = torch.zeros_like(problem.state[..., 0])
    count = torch.zeros_like(zero, dtype=torch.long)
    penalty = first_penalty(problem, x, u, factor)
    nowhere = zero + torch.inf
    return Progress(u, guess, penalty, zero + 1, nowhere, nowhere, count + OPEN, count)


def first_penalty(
    problem: Problem,
    x: Float[Tensor, "*b T1 n"],
    u: Float[Tensor, "*b T m"],
    factor: float,
) -> Float[Tensor, "*b 1 K"]:
    """A penalty whose curvature is `factor` times that of the cost, at their largest over time.

    So neither the unit of the cost nor that of a constraint makes a difference.
    """
    acting = pad_controls(u)
    _, _, curvature = expand_cost(problem.cost, x, acting)
    each = curvature.xx.diagonal(dim1=-2, dim2=-1).abs().sum(-1)
    each = each + curvature.uu.diagonal(dim1=-2, dim2=-1).abs().sum(-1)
    bend = each.amax(-1)[..., None, None]
    of_x, of_u = linearise_rows(problem.rows, x, acting)
    steep = (of_x.square().sum(-1) + of_u.square().sum(-1)).amax(-2, keepdim=True)
    steep = torch.maximum(steep, NARROW * steep.amax(-1, keepdim=True))
    usable = (steep > 0) & (bend > 0) & steep.isfinite() & bend.isfinite()
    return factor * torch.where(usable, bend / steep, torch.ones_like(steep))


def updated(
    progress: Progress,
    rows: Rows,
    solution: Solution,
    values: Float[Tensor, "*b T1 K"],
    tolerance: Float[Tensor, ""],
) -> Progress:
    """Multipliers and penalty after an inner solve; finished problems stay as they are."""
    raw = progress.multipliers + progress.penalty * values
    following, _ = next_multiplier(raw, progress.penalty, rows.linear, rows.quadratic, rows.signed)
    change = (following - progress.multipliers).abs() / progress.penalty
    error = torch.where(rows.applies, change, torch.zeros_like(change)).amax((-2, -1))
    slow = error > torch.maximum(PROGRESS * progress.error, tolerance)
    growth = torch.where(slow, progress.growth * GROWTH, progress.growth)
    growth = growth.clamp_max(MOST_GROWTH)
    limit = LARGEST_MULTIPLIER * progress.penalty / progress.growth[..., None, None]
    bad = (solution.status == SolverStatus.NOT_FINITE) | ~error.isfinite()
    after = Progress(
        solution.controls,
        following.clamp(-limit, limit),
        progress.penalty * (growth / progress.growth)[..., None, None],
        growth,
        error,
        rows.violation(values),
        torch.where(bad, SolverStatus.NOT_FINITE, progress.status),
        progress.iterations + solution.iterations,
    )
    return progress.kept_where(progress.is_open, after)
