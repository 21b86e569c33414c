"""Constraints on states and controls for `ILQR`, with exact gradients."""

from diffstack_mmv.control.constrained.constraint import (
    HARD,
    Constraint,
    Equality,
    Inequality,
    Slack,
    listed,
)
from diffstack_mmv.control.constrained.solution import ConstrainedSolution
from diffstack_mmv.control.constrained.solver import ConstrainedILQR
from diffstack_mmv.control.optimizer import ConstraintFunction, Constraints

__all__ = [
    "HARD",
    "ConstrainedILQR",
    "ConstrainedSolution",
    "Constraint",
    "ConstraintFunction",
    "Constraints",
    "Equality",
    "Inequality",
    "Slack",
    "listed",
]
