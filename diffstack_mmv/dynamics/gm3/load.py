"""Normal loads of the wheels of any layout, and the accelerations that they allow.

Accelerations are functions of state and command only, so that the dynamics have no memory and no
algebraic loop.

Source:
    GM3, Eq. 15-17, where the lateral transfer is counted on every axle and loads may become
    negative; here the axles share it by their load and every transfer is limited by the load that
    it takes from.
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require
from diffstack_mmv.smooth import limiter_gain, limiter_rest
from diffstack_mmv.types import GRAVITY
from diffstack_mmv.vehicles import ExactBuffers, VehicleSpec, axles
from diffstack_mmv.vehicles.layout import SAME_PLACE_M

_NO_LIFT = 1e4  # m/s^2, the acceleration that would lift a wheel of a vehicle with one axle


class AccelerationLimits(NamedTuple):
    """Largest longitudinal accelerations in m/s²: by friction or lift, and by lift alone."""

    drive: Float[Tensor, "..."]
    brake: Float[Tensor, "..."]
    lift_drive: Float[Tensor, "..."]
    lift_brake: Float[Tensor, "..."]


def _static_loads(spec: VehicleSpec) -> np.ndarray:
    """Loads in N of wheels on equal springs: the smallest ones that balance force and moments."""
    upright = spec.leans or spec.balanced
    rows = [np.ones(len(spec.wheels)), spec.per_wheel("x_m")]
    if not upright:
        rows.append(spec.per_wheel("y_m"))
    weight = spec.mass_kg * GRAVITY
    loads = np.linalg.pinv(np.array(rows)) @ np.array([weight] + [0.0] * (len(rows) - 1))
    for wheel, load in zip(spec.wheels, loads, strict=True):
        where = f"for wheel '{wheel.name}' of vehicle '{spec.name}'"
        remedy = "Move the wheels so that each carries a part of the weight."
        require(bool(load > 0), "static load", "be positive", f"{load:.1f} N", where, remedy)
    return loads


def _pitch_pattern(spec: VehicleSpec, static: np.ndarray) -> np.ndarray:
    """Load in N that each wheel gains per N m of pitching moment: zero in sum, rear wheels gain.

    Wheels of a staggered axle share its load, and so its mean position.
    """
    places = np.array(spec.per_wheel("x_m"))
    for axle in axles(spec.wheels):
        if np.ptp(places[axle]) > SAME_PLACE_M:
            places[axle] = np.average(places[axle], weights=static[axle])
    rows = np.array([np.ones(len(spec.wheels)), places])
    return np.linalg.pinv(rows) @ np.array([0.0, -1.0])


def _roll_pattern(spec: VehicleSpec, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Per wheel the share of its axle's load that it loses at most, and 1 / the lever of it."""
    loss, inverse_lever = np.zeros(len(share)), np.zeros(len(share))
    sides = np.array(spec.per_wheel("y_m"))
    for axle in axles(spec.wheels):
        arm = sides[axle] - sides[axle].mean()
        if np.ptp(arm) > 0:
            pattern = arm / (arm**2).sum()
            lever = min(share[axle][arm != 0] / np.abs(pattern[arm != 0]))
            loss[axle], inverse_lever[axle] = pattern * lever, 1 / lever
    return loss, inverse_lever


class LoadTransfer(ExactBuffers):
    """Loads F_z of all wheels from the accelerations.

        F_axle = F_axle,0 + m h c S-limited(a_x)
        F_i = F_axle (f_i - e_i S(m h a_y / (lever · ΣF_axle)))

    c is the pitch pattern (±1/L for two axles), f_i the static share of a wheel in its axle, e_i
    the share it loses when its side lifts. ΣF_axle sums the axles with wheels side by side. The
    sum of all loads is m g exactly, no load is negative. Vehicles that lean or are balanced move
    no load sideways.

    Args:
        spec: The vehicle.
        braking: Which wheels brake, "braked" or "driven" ones.

    Raises:
        ValueError: A wheel would carry no load at rest.
    """

    def __init__(self, spec: VehicleSpec, braking: str = "braked") -> None:
        super().__init__()
        static = _static_loads(spec)
        pitch = _pitch_pattern(spec, static)
        member = np.zeros((len(static), len(static)))
        for axle in axles(spec.wheels):
            member[np.ix_(axle, axle)] = 1.0
        axle_load = member @ static
        share = static / axle_load
        loss, inverse_lever = _roll_pattern(spec, share)
        paired = inverse_lever > 0
        self.rolls = bool(paired.any()) and not (spec.leans or spec.balanced)
        mass_height = spec.mass_kg * spec.height_m
        constants = {
            "axle_load": axle_load,
            "axle_gain": mass_height * (member @ pitch),
            "share": share - np.abs(loss) if self.rolls else share,
            "loss": np.abs(loss),
            "roll": mass_height * inverse_lever * np.sign(loss),
        }
        for name, values in constants.items():
            self.register_exact(name, [[value] for value in values.tolist()])
        self._paired_load = float(static[paired].sum())
        self._paired_gain = float(mass_height * pitch[paired].sum())
        self._lift = [_lift(static, mass_height * pitch, sign) for sign in (1.0, -1.0)]
        self._sets = []
        for name, wheels in (("drive", "driven"), ("brake", braking)):
            members = np.array(spec.per_wheel(wheels))
            self.register_exact(name, [[value] for value in (members / members.sum()).tolist()])
            self._sets.append(_wheel_set(static, spec.height_m * pitch, members, name))

    def limits(
        self, friction: Float[Tensor, "all 1"], length_scale: Float[Tensor, ""]
    ) -> AccelerationLimits:
        """Largest accelerations by the wheels that drive and by those that brake.

        A = min(μ g w / (1 ∓ μ h c_set), lift): w is the static load share of the set, c_set its
        pitch pattern, whose load grows or falls with the acceleration itself, and lift the
        acceleration at which a wheel leaves the ground.
        """
        lifts = [lift * length_scale for lift in self._lift]
        found = []
        for sign, lift, (name, share, gain) in zip((1.0, -1.0), lifts, self._sets, strict=True):
            grip = (friction * self.get_buffer(name)).sum(0)
            rest = 1 - sign * grip * gain / length_scale
            slide = GRAVITY * share * grip / torch.where(rest > 0, rest, torch.ones_like(rest))
            found.append(torch.where((rest > 0) & (slide < lift), slide, lift))
        return AccelerationLimits(found[0], found[1], lifts[0], lifts[1])

    def forward(
        self,
        acceleration: Float[Tensor, " n"],
        lateral: Float[Tensor, " n"],
        limits: AccelerationLimits,
        length_scale: Float[Tensor, ""],
    ) -> Float[Tensor, "all n"]:
        """Loads in N.

        Args:
            acceleration: a_x in m/s², within the limits of friction.
            lateral: a_y = v_x r in m/s², positive to the left.
            limits: Of this vehicle, for the lift.
            length_scale: Factor on all longitudinal positions.
        """
        lift = torch.where(acceleration > 0, limits.lift_drive, limits.lift_brake)
        pitch = acceleration * limiter_gain(acceleration / lift) / length_scale
        axle = torch.addcmul(self.get_buffer("axle_load"), self.get_buffer("axle_gain"), pitch)
        share = self.get_buffer("share")
        if self.rolls:
            paired = self._paired_load + self._paired_gain * pitch
            ratio = self.get_buffer("roll") * (lateral / paired)
            share = torch.addcmul(share, self.get_buffer("loss"), limiter_rest(ratio))
        return axle * share


def _lift(static: np.ndarray, gain: np.ndarray, sign: float) -> float:
    """Acceleration in m/s² at which the first wheel leaves the ground."""
    losing = sign * gain < -1e-9
    return float((static[losing] / np.abs(gain[losing])).min()) if losing.any() else _NO_LIFT


class _WheelSet(NamedTuple):
    name: str  # of the buffer that averages over the set
    share: float  # of the weight
    gain: float  # change of that share per m/s^2, in s^2/m


def _wheel_set(static: np.ndarray, gain: np.ndarray, members: np.ndarray, name: str) -> _WheelSet:
    weight = static.sum()
    return _WheelSet(name, float((members * static).sum() / weight), float((members * gain).sum()))
