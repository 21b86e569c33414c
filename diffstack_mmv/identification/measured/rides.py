"""Rides with measured steering and speed, and windows of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.checks import require, require_positive
from diffstack_mmv.types import Motion


class MeasuredRide(NamedTuple):
    """One track with what was measured on board, means over each step where it was faster."""

    name: str  # "recording/agent"
    position: Float[Tensor, "T 2"]  # m
    known: Bool[Tensor, " T"]  # whether the position was measured, not interpolated
    steer: Float[Tensor, " T"]  # rad, of the front wheel on the ground
    speed: Float[Tensor, " T"]  # m/s, of the wheel
    yaw_rate: Float[Tensor, " T"] | None = None  # rad/s, of the gyro
    lean: Float[Tensor, " T"] | None = None  # rad, left positive

    @property
    def recording(self) -> str:
        """Recording that the track belongs to."""
        return self.name.partition("/")[0]


OF_ENDS = ("position", "course", "known", "speed", "lean")
OF_STEPS = ("steer", "steer_rate", "yaw_rate")
"""Columns of windows with an entry for each end of a step, and for each step."""


class RideWindows(NamedTuple):
    """Windows of equal length, `w` of them, with T steps."""

    recording: Int[Tensor, " w"]  # index into the names
    names: tuple[str, ...]  # of the recordings
    origin: Float[Tensor, "w 2"]  # m, world
    position: Float[Tensor, "w T1 2"]  # m, from the origin
    course: Float[Tensor, "w T1"]  # rad, of the recorded positions
    known: Bool[Tensor, "w T1"]
    steer: Float[Tensor, "w T"]  # rad, mean of each step
    steer_rate: Float[Tensor, "w T"]  # rad/s
    speed: Float[Tensor, "w T1"]  # m/s, at the ends of the steps
    yaw_rate: Float[Tensor, "w T"]  # rad/s, NaN without gyro
    lean: Float[Tensor, "w T1"]  # rad, NaN where unknown

    @property
    def steps(self) -> int:
        """Number of steps T."""
        return self.steer.shape[-1]

    def select(self, chosen: Tensor) -> "RideWindows":
        """Some of the windows, by their numbers or a mask of shape (w,)."""
        rest = {name: value[chosen] for name, value in self._asdict().items() if name != "names"}
        return RideWindows(names=self.names, **rest)

    def without(self, recordings: Tensor) -> "RideWindows":
        """The windows of other recordings than these (r, mask), whose names are forgotten."""
        number = torch.cumsum((~recordings).long(), 0) - 1
        kept = self.select(~recordings[self.recording])
        names = tuple(
            n for n, left in zip(self.names, recordings.tolist(), strict=True) if not left
        )
        return kept._replace(names=names, recording=number[kept.recording])

    def head(self, steps: int) -> "RideWindows":
        """The first `steps` steps."""
        return self._replace(**self._cut(slice(0, steps + 1), slice(0, steps)))

    def tail(self, steps: int) -> "RideWindows":
        """All but the first `steps` steps, from the position after them."""
        rest, place = slice(steps, None), self.position[:, steps]
        moved = self._replace(
            origin=self.origin + place, position=self.position - place.unsqueeze(1)
        )
        return moved._replace(**moved._cut(rest, rest))

    def _cut(self, ends: slice, steps: slice) -> dict[str, Tensor]:
        """What there is of the ends of steps, and of steps, in stretches of them."""
        of_ends = {name: getattr(self, name)[:, ends] for name in OF_ENDS}
        return of_ends | {name: getattr(self, name)[:, steps] for name in OF_STEPS}


@dataclass(frozen=True)
class RideWindowSettings:
    """How windows are cut.

    Attributes:
        steps: Steps of a window.
        stride: Steps from the start of a window to that of the next; one more than `steps` lets no
            sample count twice, the position at the end of a window included.
        dt_s: Step of the rides in s.
        speed_min_mps: Windows that are slower somewhere are left out.
        unknown_share: Largest share of positions that are interpolated.
        jump_m: Windows are left out in which a step is longer or shorter by more than this than
            the window's measured speed explains: the receiver jumped.
    """

    steps: int = 20
    stride: int = 21
    dt_s: float = 0.1
    speed_min_mps: float = 1.5
    unknown_share: float = 0.1
    jump_m: float = 0.12

    def __post_init__(self) -> None:
        for name in ("steps", "stride", "dt_s"):
            require_positive(name, getattr(self, name))


def measured_rides(
    motions: Mapping[str, Motion],
    controls: Mapping[str, Tensor],
    sensors: Mapping[str, Tensor],
    leans: Mapping[str, Tensor],
    interpolated: Mapping[str, Tensor],
) -> list[MeasuredRide]:
    """Join what was read of each track.

    Args:
        motions: Tracks; only their positions are used, of shape (T, 2) in m.
        controls: Columns steer in rad and speed in m/s, of shape (T, 2).
        sensors: Column yaw_rate in rad/s, of shape (T, 1); tracks without are not in it.
        leans: Measured lean in rad, of shape (T,), of the tracks that have one.
        interpolated: Where positions are interpolated, of shape (T,).
    """
    return [
        MeasuredRide(
            name,
            motion.position.double(),
            ~interpolated[name],
            controls[name][:, 0].double(),
            controls[name][:, 1].double(),
            sensors[name].double()[:, 0] if name in sensors else None,
            leans.get(name),
        )
        for name, motion in motions.items()
        if name in controls
    ]


def cut_windows(rides: Sequence[MeasuredRide], settings: RideWindowSettings) -> RideWindows:
    """All windows of the rides that are complete.

    Raises:
        ValueError: No ride holds one.
    """
    names = tuple(sorted({ride.recording for ride in rides}))
    index = {name: number for number, name in enumerate(names)}
    parts = [
        _window(ride, start, index[ride.recording], names, settings.steps, settings.dt_s)
        for ride in rides
        for start in _starts(ride, settings)
    ]
    wanted = f"hold {settings.steps} steps over {settings.speed_min_mps:g} m/s somewhere"
    remedy = (
        "Cut shorter windows, or change `speed_min_mps`; where the speed is in m/s and positions "
        f"still jump by more than {settings.jump_m:g} m beside it, raise `jump_m`."
    )
    require(len(parts) > 0, "rides", wanted, "none", "", remedy)
    columns = {
        name: torch.stack([getattr(part, name) for part in parts])
        for name in RideWindows._fields
        if name != "names"
    }
    return RideWindows(names=names, **columns)


def chord_course(position: Float[Tensor, "*b T1 2"], reach: int = 4) -> Float[Tensor, "*b T1"]:
    """Directions in rad of the chords over some steps to both sides."""
    index = torch.arange(position.shape[-2])
    after, before = (index + reach).clamp(max=len(index) - 1), (index - reach).clamp(min=0)
    way = position[..., after, :] - position[..., before, :]
    return torch.atan2(way[..., 1], way[..., 0])


def _starts(ride: MeasuredRide, settings: RideWindowSettings) -> list[int]:
    """First rows of the windows of a ride."""
    whole = ride.steer.isfinite() & (ride.speed > settings.speed_min_mps)
    found, start, length = [], 0, settings.steps + 1
    while start + length <= len(whole):
        part = slice(start, start + length)
        bad = (~whole[part]).nonzero()
        smooth = _largest_jump(ride, part, settings.dt_s) <= settings.jump_m
        few = float((~ride.known[part]).double().mean()) <= settings.unknown_share
        if len(bad):
            start += int(bad[-1]) + 1
        elif few and smooth:
            found.append(start)
            start += settings.stride
        else:
            start += 1
    return found


def _largest_jump(ride: MeasuredRide, part: slice, dt_s: float) -> float:
    """Largest difference in m between the lengths of steps by position and by speed."""
    way = ride.position[part].diff(dim=0)
    expected = dt_s * ride.speed[part][:-1]
    by_position = way.norm(dim=-1)
    pace = (by_position.sum() / expected.sum()).clamp(0.8, 1.25)
    turned = (way[1:] - way[:-1]).norm(dim=-1).amax()
    return float(torch.maximum((by_position - pace * expected).abs().amax(), 0.5 * turned))


def _window(
    ride: MeasuredRide, start: int, number: int, names: tuple[str, ...], steps: int, dt_s: float
) -> RideWindows:
    """One window, without a leading dimension."""
    ends, each = slice(start, start + steps + 1), slice(start, start + steps)
    speed = ride.speed.clone()
    speed[1:] = 0.5 * (ride.speed[1:] + ride.speed[:-1])
    (rate,) = torch.gradient(ride.steer[each], spacing=dt_s)
    missing = torch.full_like(ride.speed, torch.nan)
    yaw_rate = missing if ride.yaw_rate is None else ride.yaw_rate
    lean = missing if ride.lean is None else ride.lean
    origin = ride.position[start]
    return RideWindows(
        recording=torch.tensor(number),
        names=names,
        origin=origin,
        position=ride.position[ends] - origin,
        course=chord_course(ride.position[ends]),
        known=ride.known[ends],
        steer=ride.steer[each],
        steer_rate=rate,
        speed=speed[ends],
        yaw_rate=yaw_rate[each],
        lean=lean[ends],
    )
