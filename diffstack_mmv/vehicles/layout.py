"""Which wheel layouts can stand and drive."""

from collections.abc import Sequence
from itertools import combinations

from diffstack_mmv.vehicles.parts import (
    AckermannSteering,
    DifferentialDrive,
    Steering,
    TruckSteering,
    WheelSpec,
)
from dmmv_conventions.checks import require

SAME_PLACE_M = 1e-3


def turning_axle_m(wheels: Sequence[WheelSpec]) -> float:
    """Longitudinal position of the axle that does not steer, on whose line the turning centre lies.

    The mean position of the rolling wheels that are neither steered nor on a truck; 0 where there
    is none.
    """
    fixed = [w.x_m for w in wheels if not (w.steered or w.truck or w.caster)]
    return sum(fixed) / len(fixed) if fixed else 0.0


def axles(wheels: Sequence[WheelSpec]) -> list[list[int]]:
    """Group wheel indices by their longitudinal position, front axle first."""
    order = sorted(range(len(wheels)), key=lambda index: -wheels[index].x_m)
    groups: list[list[int]] = []
    for index in order:
        if groups and abs(wheels[groups[-1][0]].x_m - wheels[index].x_m) < SAME_PLACE_M:
            groups[-1].append(index)
        else:
            groups.append([index])
    return groups


def _require_support(wheels: Sequence[WheelSpec], upright: bool, where: str) -> None:
    front, rear = max(wheel.x_m for wheel in wheels), min(wheel.x_m for wheel in wheels)
    single = front - rear < SAME_PLACE_M
    between = abs(front) < SAME_PLACE_M if single else rear < 0 < front
    require(
        between,
        "wheels",
        "carry the centre of gravity between the front and the rear axle",
        f"axles at x_m from {rear:g} to {front:g}",
        where,
        "Positions are relative to the centre of gravity, x forward.",
    )
    left, right = max(wheel.y_m for wheel in wheels), min(wheel.y_m for wheel in wheels)
    require(
        right <= 0 <= left,
        "wheels",
        "stand on both sides of the centre of gravity, or below it",
        f"y_m from {right:g} to {left:g}",
        where,
    )
    single_track = len(wheels) == len(axles(wheels))
    require(
        left == right or not single_track,
        "wheels",
        "stand in one line, y_m: 0, where no two are side by side",
        f"y_m from {right:g} to {left:g}",
        where,
    )
    stands = any(len({wheels[index].y_m for index in axle}) > 1 for axle in axles(wheels))
    require(
        upright or stands,
        "leans or balanced",
        "be true for a vehicle without two wheels side by side",
        "false for both",
        where,
        "Nothing else keeps it upright.",
    )


def _require_steering(wheels: Sequence[WheelSpec], steering: Steering, where: str) -> None:
    steered = [wheel for wheel in wheels if wheel.steered]
    trucks = [wheel for wheel in wheels if wheel.truck]
    sides = {wheel.y_m for wheel in wheels if wheel.driven}
    able = {
        AckermannSteering: bool(steered) and not trucks,
        TruckSteering: bool(trucks) and not steered,
        DifferentialDrive: len(sides) > 1 and not steered and not trucks,
    }
    need = {
        AckermannSteering: "at least one steered wheel and no truck",
        TruckSteering: "wheels on trucks and no steered wheel",
        DifferentialDrive: "driven wheels on both sides and no steered wheel",
    }
    kind = type(steering)
    require(able[kind], "wheels", f"have {need[kind]} for {kind.__name__}", "none such", where)


def require_possible_layout(
    wheels: Sequence[WheelSpec], steering: Steering, upright: bool, where: str
) -> None:
    """Refuse wheels that cannot stand, steer, drive or brake.

    Raises:
        ValueError: Wheels are missing or coincide, do not support the centre of gravity, or do not
            suit the steering.
    """
    require(len(wheels) >= 2, "wheels", "be at least two", len(wheels), where)
    for first, second in combinations(wheels, 2):
        apart = max(abs(first.x_m - second.x_m), abs(first.y_m - second.y_m))
        require(
            apart >= SAME_PLACE_M,
            "wheels",
            "stand at different places",
            f"'{first.name}' and '{second.name}' at the same one (zero wheelbase and track)",
            where,
            "Set x_m and y_m.",
        )
    require(
        any(wheel.driven for wheel in wheels),
        "wheels",
        "have a driven one",
        "none",
        where,
        "Set driven: true.",
    )
    require(
        any(wheel.braked for wheel in wheels),
        "wheels",
        "have a braked one",
        "none",
        where,
        "Set braked: true.",
    )
    _require_support(wheels, upright, where)
    _require_steering(wheels, steering, where)
