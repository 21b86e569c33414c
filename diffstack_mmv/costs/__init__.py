"""Cost terms of a plan, and their learnable sum."""

from diffstack_mmv.costs.base import CostTerm
from diffstack_mmv.costs.clearance import ExpectedCollision, OutlineClearance, TurningCircleBarrier
from diffstack_mmv.costs.effort import ControlEffort, LateralAcceleration, YawRate
from diffstack_mmv.costs.goal import (
    BrakingProfile,
    FinalGoal,
    GoalOutsideTurn,
    HeadingToGoal,
    ReferenceSpeed,
    RunningGoal,
)
from diffstack_mmv.costs.limits import Reversing, SpeedLimit
from diffstack_mmv.costs.tracking import ReferenceTracking
from diffstack_mmv.costs.weighted import WeightedCost

__all__ = [
    "BrakingProfile",
    "ControlEffort",
    "CostTerm",
    "ExpectedCollision",
    "FinalGoal",
    "GoalOutsideTurn",
    "HeadingToGoal",
    "LateralAcceleration",
    "OutlineClearance",
    "ReferenceSpeed",
    "ReferenceTracking",
    "Reversing",
    "RunningGoal",
    "SpeedLimit",
    "TurningCircleBarrier",
    "WeightedCost",
    "YawRate",
]
