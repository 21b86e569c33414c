"""Vehicles: what they are made of, where their numbers come from, and how to load them.

Only what learns needs torch, and comes when it is asked for.
"""

from typing import TYPE_CHECKING

from diffstack_mmv.vehicles.catalogue import (
    config_folder,
    load_vehicle,
    save_vehicle,
    vehicle_names,
)
from diffstack_mmv.vehicles.layout import axles, turning_axle_m
from diffstack_mmv.vehicles.parts import (
    BODY_PARAMETERS,
    WHEEL_PARAMETERS,
    AckermannSteering,
    DifferentialDrive,
    FootprintSpec,
    Limits,
    Smoothing,
    Steering,
    TruckSteering,
    WheelSpec,
)
from diffstack_mmv.vehicles.quantity import ParameterSpec
from diffstack_mmv.vehicles.spec import VehicleSpec, require_vehicle
from dmmv_conventions.on_demand import on_demand

if TYPE_CHECKING:
    from diffstack_mmv.vehicles.parameter import ExactBuffers, SoftClamped

__getattr__ = on_demand(__name__, __file__, "stack")
__all__ = [
    "BODY_PARAMETERS",
    "WHEEL_PARAMETERS",
    "AckermannSteering",
    "DifferentialDrive",
    "ExactBuffers",
    "FootprintSpec",
    "Limits",
    "ParameterSpec",
    "Smoothing",
    "SoftClamped",
    "Steering",
    "TruckSteering",
    "VehicleSpec",
    "WheelSpec",
    "axles",
    "config_folder",
    "load_vehicle",
    "require_vehicle",
    "save_vehicle",
    "turning_axle_m",
    "vehicle_names",
]
