"""Constraints on states and controls for `ILQR`, with exact gradients."""

from diffstack_mmv.control.constrained.constraint import (
    HARD,
    Constraint,
    ConstraintFunction,
    Equality,
    Inequality,
    Slack,
)
from diffstack_mmv.control.constrained.solution import ConstrainedSolution
from diffstack_mmv.control.constrained.solver import ConstrainedILQR

__all__ = [
    "HARD",
    "ConstrainedILQR",
    "ConstrainedSolution",
    "Constraint",
    "ConstraintFunction",
    "Equality",
    "Inequality",
    "Slack",
]
