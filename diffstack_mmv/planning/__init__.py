"""From a forecast and a goal to a plan."""

from diffstack_mmv.planning.candidates import CandidateFan, Candidates, with_final_row
from diffstack_mmv.planning.goal import FutureGoal, GoalSource, PredictedGoal
from diffstack_mmv.planning.planner import MPCPlanner, Planner
from diffstack_mmv.planning.problem import (
    build_problem,
    disc_radius,
    observed_obstacles,
    predicted_obstacles,
    present,
    reference_to_goal,
)
from diffstack_mmv.planning.selection import closest_candidate, cross_entropy

__all__ = [
    "CandidateFan",
    "Candidates",
    "FutureGoal",
    "GoalSource",
    "MPCPlanner",
    "Planner",
    "PredictedGoal",
    "build_problem",
    "closest_candidate",
    "cross_entropy",
    "disc_radius",
    "observed_obstacles",
    "predicted_obstacles",
    "present",
    "reference_to_goal",
    "with_final_row",
]
