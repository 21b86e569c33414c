"""Which wheel layouts can stand and drive."""

import math
from collections.abc import Sequence
from itertools import combinations, pairwise

from diffstack_mmv.vehicles.parts import (
    AckermannSteering,
    DifferentialDrive,
    Steering,
    TruckSteering,
    WheelSpec,
)
from dmmv_conventions.checks import require

SAME_PLACE_M = 1e-3
STAGGER_SHARE = 0.4  # of the length; two single wheels this near to each other make up an axle


def turning_axle_m(wheels: Sequence[WheelSpec]) -> float:
    """Longitudinal position of the axle that does not steer, on whose line the turning centre lies.

    The mean position of the rolling wheels that are neither steered nor on a truck; 0 where there
    is none.
    """
    fixed = [w.x_m for w in wheels if not (w.steered or w.truck or w.caster)]
    return sum(fixed) / len(fixed) if fixed else 0.0


def steered_length_m(wheels: Sequence[WheelSpec]) -> float:
    """Length in m of the bicycle that turns alike, 0 where no wheel steers.

    From the foremost to the rearmost of the wheels that steer and the axle that does not.
    """
    origin = turning_axle_m(wheels)
    ahead = [0.0, *(w.x_m - origin for w in wheels if w.steered or w.truck)]
    return max(ahead) - min(ahead)


def axles(wheels: Sequence[WheelSpec]) -> list[list[int]]:
    """Group wheel indices by their longitudinal position, front axle first.

    A wheel that stands alone and the next one behind it, on another side, make up an axle as well
    where they are near to each other: the wheel of a sidecar stands ahead of the rear wheel.
    """
    order = sorted(range(len(wheels)), key=lambda index: -wheels[index].x_m)
    groups: list[list[int]] = []
    for index in order:
        if groups and abs(wheels[groups[-1][0]].x_m - wheels[index].x_m) < SAME_PLACE_M:
            groups[-1].append(index)
        else:
            groups.append([index])
    near = STAGGER_SHARE * (wheels[order[0]].x_m - wheels[order[-1]].x_m)
    joined: list[list[int]] = []
    gaps = _gaps(wheels, groups)
    for place, group in enumerate(groups):
        ahead, behind = gaps[place], gaps[place + 1]
        if ahead < near and ahead <= behind and len(joined[-1]) == 1:
            joined[-1] = joined[-1] + group
        else:
            joined.append(group)
    return joined


def _gaps(wheels: Sequence[WheelSpec], groups: Sequence[list[int]]) -> list[float]:
    """Way in m from each group to the next one behind, infinite unless both are single wheels."""
    gaps = [math.inf]
    for first, second in pairwise(groups):
        front, rear = wheels[first[0]], wheels[second[0]]
        beside = len(first) == len(second) == 1 and front.y_m != rear.y_m
        gaps.append(front.x_m - rear.x_m if beside else math.inf)
    return [*gaps, math.inf]


def _holds_centre(wheels: Sequence[WheelSpec]) -> bool:
    """Whether the centre of gravity lies in the hull of the contact points, or on its edge.

    It does unless all points are seen from there within less than half a turn.
    """
    seen = sorted(math.atan2(w.y_m, w.x_m) for w in wheels if w.x_m or w.y_m)
    if len(seen) < len(wheels):
        return True
    turns = [after - before for before, after in pairwise([*seen, seen[0] + 2 * math.pi])]
    return max(turns) <= math.pi + 1e-9


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
        f"Two are side by side within {STAGGER_SHARE:.0%} of the length.",
    )
    require(
        _holds_centre(wheels),
        "wheels",
        "have the centre of gravity within the outline of their contact points",
        f"points ({', '.join(f'{wheel.x_m:g} {wheel.y_m:g}' for wheel in wheels)})",
        where,
        "Positions are relative to the centre of gravity, x forward, y left.",
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
    require(
        kind is DifferentialDrive or steered_length_m(wheels) >= SAME_PLACE_M,
        "wheels",
        "steer at some distance from the axle that does not",
        f"x_m of {', '.join(f'{wheel.x_m:g}' for wheel in steered + trucks)}",
        where,
        "A vehicle with one axle turns by its driven wheels, `steering: {differential: ...}`.",
    )


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
