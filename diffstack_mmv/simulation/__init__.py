"""Closed-loop simulation: scenarios, pedestrians, robots, verdicts and the environment."""

from diffstack_mmv.simulation.adaptation import AdaptiveController, models_by_friction
from diffstack_mmv.simulation.assembly import (
    SimulatedVehicle,
    actuation,
    controller_model,
    require_stoppable,
    vehicle_box,
    vehicle_footprint,
    vehicle_robot,
)
from diffstack_mmv.simulation.benchmark import Campaign, Method
from diffstack_mmv.simulation.chunks import Chunk, read_chunk, read_episode, read_thoughts
from diffstack_mmv.simulation.collision import DiscFootprint, Footprint, RectangleFootprint
from diffstack_mmv.simulation.controller import DiffMPCController
from diffstack_mmv.simulation.crossings import CircleCrossing, SquareCrossing
from diffstack_mmv.simulation.decisions import Controller, Decided
from diffstack_mmv.simulation.delay import DelayCompensation
from diffstack_mmv.simulation.ego import EgoInstruments, EgoStateEstimator, EstimatingController
from diffstack_mmv.simulation.env import ENV_ID, CrowdNavEnv, register, robot_named
from diffstack_mmv.simulation.episode import drive
from diffstack_mmv.simulation.feasibility import AvoidanceSearch
from diffstack_mmv.simulation.forecasters import (
    ConstantVelocityForecaster,
    OrcaForecaster,
    PedestrianForecast,
    PedestrianForecaster,
    StandingForecaster,
    TurningForecaster,
)
from diffstack_mmv.simulation.hedging import MixedForecaster
from diffstack_mmv.simulation.learned_forecaster import LearnedForecaster
from diffstack_mmv.simulation.learned_policy import LearnedPolicy
from diffstack_mmv.simulation.learning import imitation_loss, way_left_loss
from diffstack_mmv.simulation.mppi import MPPIController
from diffstack_mmv.simulation.observation import Observation
from diffstack_mmv.simulation.pedestrians import (
    AbruptCrowd,
    OrcaCrowd,
    ReactiveReplayCrowd,
    ReplayCrowd,
    SocialForceCrowd,
    SuddenCrowd,
)
from diffstack_mmv.simulation.policies import BlindDriver, OrcaPolicy, StopAndGoDriver, StraightLine
from diffstack_mmv.simulation.recorded import (
    CrossingRules,
    KnownFuture,
    PassageRules,
    RecordedCrossing,
)
from diffstack_mmv.simulation.robot import HolonomicRobot, Robot, UnicycleRobot
from diffstack_mmv.simulation.scenario import Scenario
from diffstack_mmv.simulation.scene import Scene
from diffstack_mmv.simulation.sensing import LimitedSensing
from diffstack_mmv.simulation.study import is_massless, models_told, study_world, world_for
from diffstack_mmv.simulation.summary import summarise
from diffstack_mmv.simulation.tracking import PedestrianTracker, TrackingController
from diffstack_mmv.simulation.vector_env import CrowdNavVectorEnv
from diffstack_mmv.simulation.vehicle_robot import Actuation, VehicleRobot
from diffstack_mmv.simulation.verdict import Rewards, Verdict
from diffstack_mmv.simulation.verdicts import (
    VERDICTS,
    CrowdNavVerdict,
    ExactVerdict,
    verdict_named,
)
from diffstack_mmv.simulation.views import EgoView, WorldView
from diffstack_mmv.simulation.wandering import WanderingCrossing
from diffstack_mmv.simulation.world import World, WorldState
from diffstack_mmv.simulation.zero_order_hold import ZeroOrderHold

__all__ = [
    "ENV_ID",
    "VERDICTS",
    "AbruptCrowd",
    "Actuation",
    "AdaptiveController",
    "AvoidanceSearch",
    "BlindDriver",
    "Campaign",
    "Chunk",
    "CircleCrossing",
    "ConstantVelocityForecaster",
    "Controller",
    "Decided",
    "CrossingRules",
    "DelayCompensation",
    "CrowdNavEnv",
    "CrowdNavVectorEnv",
    "CrowdNavVerdict",
    "DiffMPCController",
    "DiscFootprint",
    "EgoInstruments",
    "EgoStateEstimator",
    "EstimatingController",
    "EgoView",
    "ExactVerdict",
    "Footprint",
    "ZeroOrderHold",
    "HolonomicRobot",
    "KnownFuture",
    "MPPIController",
    "MixedForecaster",
    "Method",
    "Observation",
    "OrcaCrowd",
    "OrcaForecaster",
    "OrcaPolicy",
    "PedestrianForecast",
    "PassageRules",
    "PedestrianForecaster",
    "PedestrianTracker",
    "LearnedForecaster",
    "LearnedPolicy",
    "ReactiveReplayCrowd",
    "RecordedCrossing",
    "LimitedSensing",
    "RectangleFootprint",
    "ReplayCrowd",
    "Rewards",
    "Robot",
    "Scenario",
    "Scene",
    "SimulatedVehicle",
    "SocialForceCrowd",
    "SquareCrossing",
    "StopAndGoDriver",
    "StandingForecaster",
    "StraightLine",
    "TrackingController",
    "TurningForecaster",
    "SuddenCrowd",
    "UnicycleRobot",
    "VehicleRobot",
    "Verdict",
    "WanderingCrossing",
    "World",
    "WorldState",
    "WorldView",
    "actuation",
    "controller_model",
    "drive",
    "imitation_loss",
    "is_massless",
    "models_by_friction",
    "models_told",
    "read_chunk",
    "read_episode",
    "read_thoughts",
    "register",
    "require_stoppable",
    "robot_named",
    "study_world",
    "summarise",
    "vehicle_box",
    "vehicle_footprint",
    "vehicle_robot",
    "verdict_named",
    "way_left_loss",
    "world_for",
]

register()
