"""Differentiable model predictive control: `ILQR`, and the interfaces it works with."""

from diffstack_mmv.control.curvature import (
    CurvatureBySize,
    CurvatureForm,
    DifferencedCurvature,
    ExactCurvature,
)
from diffstack_mmv.control.expansion import pad_controls
from diffstack_mmv.control.gradient import GradientMode, Implicit, Unrolled
from diffstack_mmv.control.ilqr import ILQR
from diffstack_mmv.control.optimizer import (
    Constraints,
    Cost,
    Dynamics,
    LinearisedDynamics,
    TrajectoryOptimizer,
)
from diffstack_mmv.control.selection import Batched, Selectable
from diffstack_mmv.types import Bounds, Solution, SolverStatus

__all__ = [
    "ILQR",
    "Batched",
    "Bounds",
    "Constraints",
    "Cost",
    "CurvatureBySize",
    "CurvatureForm",
    "DifferencedCurvature",
    "Dynamics",
    "ExactCurvature",
    "GradientMode",
    "Implicit",
    "LinearisedDynamics",
    "Selectable",
    "Solution",
    "SolverStatus",
    "TrajectoryOptimizer",
    "Unrolled",
    "pad_controls",
]
