"""From a forecast and a goal to a plan."""

from diffstack_mmv.planning.candidates import (
    CandidateFan,
    Candidates,
    CandidateSource,
    Coasting,
)
from diffstack_mmv.planning.choice import CheapestSafe, Options, PlanChoice, TakeOptimum
from diffstack_mmv.planning.clearance import ClearanceMargin, clearance_within_steps
from diffstack_mmv.planning.coordinates import (
    AccelerationShares,
    ControlCoordinates,
    Coordinates,
    PhysicalControls,
    above_rest,
)
from diffstack_mmv.planning.detours import DetourFan
from diffstack_mmv.planning.generated import generated_moments
from diffstack_mmv.planning.goal import FutureGoal, GoalSource, PredictedGoal, WantedGoal
from diffstack_mmv.planning.homotopy import best_of_each, homotopy_class
from diffstack_mmv.planning.limits import (
    ClearanceKept,
    FrictionCircle,
    PlanConstraints,
    PlanLimit,
    SpeedWithin,
)
from diffstack_mmv.planning.planner import MPCPlanner, Planner, PlannerState
from diffstack_mmv.planning.pricing import (
    CostScore,
    PlanPrice,
    Plans,
    PlanScore,
    ScoredPlans,
    Situation,
)
from diffstack_mmv.planning.problem import (
    Reference,
    build_problem,
    disc_radius,
    initial_state,
    observed_obstacles,
    predicted_obstacles,
    predicted_reference,
    straight_reference,
    tracked_ego,
)
from diffstack_mmv.planning.pursuit import Pursuit
from diffstack_mmv.planning.selection import closest_candidate, cross_entropy

__all__ = [
    "AccelerationShares",
    "CandidateFan",
    "CandidateSource",
    "Candidates",
    "CheapestSafe",
    "ClearanceKept",
    "FrictionCircle",
    "PlanConstraints",
    "PlanLimit",
    "SpeedWithin",
    "ClearanceMargin",
    "Coasting",
    "ControlCoordinates",
    "Coordinates",
    "CostScore",
    "DetourFan",
    "FutureGoal",
    "GoalSource",
    "MPCPlanner",
    "Options",
    "PhysicalControls",
    "PlanChoice",
    "PlanPrice",
    "PlanScore",
    "Plans",
    "Planner",
    "PlannerState",
    "PredictedGoal",
    "Pursuit",
    "Reference",
    "ScoredPlans",
    "Situation",
    "TakeOptimum",
    "WantedGoal",
    "above_rest",
    "best_of_each",
    "build_problem",
    "clearance_within_steps",
    "closest_candidate",
    "cross_entropy",
    "disc_radius",
    "generated_moments",
    "homotopy_class",
    "initial_state",
    "observed_obstacles",
    "predicted_obstacles",
    "predicted_reference",
    "straight_reference",
    "tracked_ego",
]
