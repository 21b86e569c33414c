"""Predictors: where the ego and its neighbors will be."""

# also here, because the configurations of earlier checkpoints name it so
from diffstack_mmv.dynamics import SingleIntegrator
from diffstack_mmv.prediction.base import (
    Predictor,
    all_agents,
    ego_forecast,
    forecasts_of,
    neighbors_forecast,
    strongest,
)
from diffstack_mmv.prediction.baseline_paths import Baseline, PathToGoal, PredictedPath
from diffstack_mmv.prediction.baselines import (
    ConstantVelocity,
    GroundTruth,
    NoPrediction,
    Spread,
    StandStill,
    single_component,
    without_dynamics,
)
from diffstack_mmv.prediction.combination import combined_path
from diffstack_mmv.prediction.ctra import ConstantTurnRateAcceleration
from diffstack_mmv.prediction.current import motion_along
from diffstack_mmv.prediction.ensemble import Ensemble
from diffstack_mmv.prediction.goal_baselines import (
    constant_acceleration,
    hermite_spline,
    straight_line,
)
from diffstack_mmv.prediction.kalman import KalmanConstantVelocity
from diffstack_mmv.prediction.trajectron import Annealing, Sizes, Trajectron

__all__ = [
    "Annealing",
    "Baseline",
    "ConstantTurnRateAcceleration",
    "ConstantVelocity",
    "Ensemble",
    "GroundTruth",
    "KalmanConstantVelocity",
    "NoPrediction",
    "PathToGoal",
    "PredictedPath",
    "Predictor",
    "SingleIntegrator",
    "Sizes",
    "Spread",
    "StandStill",
    "Trajectron",
    "all_agents",
    "combined_path",
    "constant_acceleration",
    "ego_forecast",
    "forecasts_of",
    "motion_along",
    "hermite_spline",
    "neighbors_forecast",
    "single_component",
    "straight_line",
    "strongest",
    "without_dynamics",
]
