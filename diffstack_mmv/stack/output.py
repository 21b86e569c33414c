"""What the stages of a stack make of a batch."""

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.types import Forecast, Plan, PlanningProblem


class StackOutput(NamedTuple):
    """Forecast, goal, and the problem and plan that follow from them."""

    forecast: Forecast  # B 1+N K T, the ego first
    goal: Float[Tensor, "B 2"]  # m
    problem: PlanningProblem
    plan: Plan
