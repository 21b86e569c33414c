"""Stretches of recorded tracks that are fit for identification, and which of them to take."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Generator, Tensor

from diffstack_mmv.checks import require, require_at_least, require_positive
from diffstack_mmv.geometry import wrap_angle
from diffstack_mmv.types import Motion


class Stretch(NamedTuple):
    """A stretch of one track in which the vehicle moves."""

    name: str
    position: Float[Tensor, "T1 2"]  # m
    course: Float[Tensor, " T1"]  # rad, direction of travel, without jumps
    speed: Float[Tensor, " T1"]  # m/s
    controls: Float[Tensor, "T1 m"] | None = None  # measured, where a data set has them
    lean: Float[Tensor, " T1"] | None = None  # rad, measured, positive to the left

    @property
    def recording(self) -> str:
        """The recording it was cut from: what fitted and held-out tracks must not share."""
        return self.name.split("@")[0]


class StretchBatch(NamedTuple):
    """Stretches of different lengths, padded at the end with their last row."""

    names: tuple[str, ...]
    position: Float[Tensor, "N T1 2"]  # m
    course: Float[Tensor, "N T1"]  # rad
    speed: Float[Tensor, "N T1"]  # m/s
    valid: Bool[Tensor, "N T1"]
    controls: Float[Tensor, "N T1 m"] | None = None

    @property
    def samples(self) -> Float[Tensor, " N"]:
        """Number of recorded positions of each stretch."""
        return self.valid.sum(-1).to(self.position)


@dataclass(frozen=True)
class StretchSettings:
    """What a stretch must be.

    Args:
        dt_s: Step of the tracks.
        min_s: Shortest stretch.
        max_s: Longer motion is cut into stretches of that length.
        speed_min_mps: A slower sample ends the stretch: near standstill a course says nothing.
        trim_s: Left out at both ends of a track, where its smoother looked past the end.

    Raises:
        ValueError: A number is not positive, or the shortest is longer than the longest.
    """

    dt_s: float = 0.1
    min_s: float = 3.0
    max_s: float = 6.0
    speed_min_mps: float = 1.0
    trim_s: float = 0.5

    def __post_init__(self) -> None:
        for name in ("dt_s", "min_s", "speed_min_mps"):
            require_positive(name, getattr(self, name))
        require_at_least("max_s", self.max_s, self.min_s)
        require_at_least("trim_s", self.trim_s, 0.0)


@runtime_checkable
class Choice(Protocol):
    """Which stretches to prefer."""

    def __call__(
        self, stretches: Sequence[Stretch], generator: Generator
    ) -> Float[Tensor, " stretches"]:
        """Score of each stretch; the highest are taken."""
        ...


class RandomChoice:
    """Any stretch."""

    def __call__(
        self, stretches: Sequence[Stretch], generator: Generator
    ) -> Float[Tensor, " stretches"]:
        """Random scores."""
        return torch.rand(len(stretches), generator=generator, dtype=torch.float64)


class LongestChoice:
    """The stretches with the longest path in m."""

    def __call__(
        self, stretches: Sequence[Stretch], generator: Generator
    ) -> Float[Tensor, " stretches"]:
        """Length of the path in m."""
        return torch.stack([each.position.diff(dim=0).norm(dim=-1).sum() for each in stretches])


@dataclass(frozen=True)
class ExcitingChoice:
    """The stretches with the highest lateral acceleration and yaw rate.

    The score is the root mean square of v r / a_0 plus that of r / r_0, with the yaw rate r taken
    over a second: from step to step it is mostly noise.

    Args:
        lateral_mps2: a_0, a lively lateral acceleration.
        yaw_rate_radps: r_0, a lively yaw rate.
        dt_s: Step of the tracks.
    """

    lateral_mps2: float = 2.0
    yaw_rate_radps: float = 0.5
    dt_s: float = 0.1

    def __call__(
        self, stretches: Sequence[Stretch], generator: Generator
    ) -> Float[Tensor, " stretches"]:
        """Excitation of each stretch, dimensionless."""
        scores = []
        for each in stretches:
            lag = min(round(1.0 / self.dt_s), len(each.course) - 1)
            yaw_rate = (each.course[lag:] - each.course[:-lag]) / (lag * self.dt_s)
            lateral = yaw_rate * each.speed[lag:] / self.lateral_mps2
            turning = yaw_rate / self.yaw_rate_radps
            scores.append(lateral.square().mean().sqrt() + turning.square().mean().sqrt())
        return torch.stack(scores)


def cut(
    tracks: Mapping[str, Motion],
    settings: StretchSettings,
    leans: Mapping[str, Tensor] | None = None,
    controls: Mapping[str, Tensor] | None = None,
) -> list[Stretch]:
    """Cut tracks into stretches of steady motion, one after the other without overlap.

    Args:
        tracks: Motion (T) by name.
        settings: What a stretch must be.
        leans: Measured lean (T) in rad of some tracks.
        controls: Recorded controls (T, m), NaN where there are none. Where they are given,
            stretches have controls all along.

    Raises:
        ValueError: No track holds a stretch of the shortest length.
    """
    rows = round(settings.max_s / settings.dt_s) + 1
    fewest = round(settings.min_s / settings.dt_s) + 1
    trim = round(settings.trim_s / settings.dt_s)
    found = []
    for name, motion in tracks.items():
        usable = motion.velocity.norm(dim=-1) >= settings.speed_min_mps
        usable[:trim] = False
        usable[max(len(usable) - trim, 0) :] = False
        extras = _Extras((leans or {}).get(name), (controls or {}).get(name))
        if controls is not None:
            usable &= _recorded(extras.controls, usable)
        for first, last in _runs(usable):
            for start in range(first, last - fewest + 1, rows):
                part = slice(start, min(start + rows, last))
                if part.stop - start >= fewest:
                    found.append(_stretch(name, motion, extras, part, settings.dt_s))
    longest = max(len(motion.heading) for motion in tracks.values()) * settings.dt_s
    known = "" if controls is None else " with recorded controls"
    require(
        len(found) > 0,
        "tracks",
        f"hold a stretch of {settings.min_s:g} s above {settings.speed_min_mps:g} m/s{known}",
        f"{len(tracks)} tracks, the longest of {longest:g} s, without one",
        remedy="Lower `stretch.min_s` or `stretch.speed_min_mps`.",
    )
    return found


def batch(stretches: Sequence[Stretch]) -> StretchBatch:
    """Stack stretches, the shorter ones padded with their last row.

    Raises:
        ValueError: There is none, or a position is not finite.
    """
    require(len(stretches) > 0, "stretches", "be at least one", 0)
    rows = max(len(each.speed) for each in stretches)

    def stacked(columns: Sequence[Tensor]) -> Tensor:
        return torch.stack(
            [torch.cat([column, column[-1:].expand(rows - len(column), *column.shape[1:])])
             for column in columns]
        )  # fmt: skip

    for each in stretches:
        finite = bool(each.position.isfinite().all() and each.course.isfinite().all())
        require(finite, "tracks", "be finite", "NaN or infinite positions", f"in '{each.name}'")
    lengths = torch.tensor([len(each.speed) for each in stretches])
    measured = [each.controls for each in stretches if each.controls is not None]
    return StretchBatch(
        names=tuple(each.name for each in stretches),
        position=stacked([each.position for each in stretches]),
        course=stacked([each.course for each in stretches]),
        speed=stacked([each.speed for each in stretches]),
        valid=torch.arange(rows) < lengths.unsqueeze(-1),
        controls=stacked(measured) if len(measured) == len(stretches) else None,
    )


class Division(NamedTuple):
    """Stretches to fit, and stretches of other recordings to judge the fit by."""

    fitted: list[Stretch]
    heldout: list[Stretch]


def divide(
    stretches: Sequence[Stretch], choice: Choice, fitted: int, heldout: int, seed: int
) -> Division:
    """Take the preferred stretches and divide them at random, recordings kept together.

    With a single recording, its stretches are divided instead.

    Args:
        stretches: All stretches.
        choice: Which to prefer.
        fitted: Number of stretches to fit, at most.
        heldout: Number to hold out, at most.
        seed: Of all that is random here.

    Raises:
        ValueError: A number is below one, or there are fewer than two stretches.
    """
    require_at_least("tracks", fitted, 1)
    require_at_least("heldout", heldout, 1)
    require_at_least("stretches", len(stretches), 2, remedy="One is fitted, one held out.")
    generator = Generator().manual_seed(seed)
    order = choice(stretches, generator).argsort(descending=True).tolist()
    wanted = min(len(order), fitted + heldout)
    kept = max(1, min(heldout, round(wanted * heldout / (fitted + heldout)), wanted - 1))
    single = len({each.recording for each in stretches}) == 1
    groups: dict[str, int] = {}
    for index in order[:wanted]:
        group = stretches[index].name if single else stretches[index].recording
        groups[group] = groups.get(group, 0) + 1
    names = [list(groups)[i] for i in torch.randperm(len(groups), generator=generator).tolist()]
    out: set[str] = set()
    for name in names[: len(names) - 1]:
        if sum(groups[each] for each in out) < kept:
            out.add(name)
    division = Division([], [])
    for index in order:
        each = stretches[index]
        name = each.name if single else each.recording
        part, limit = (division.heldout, heldout) if name in out else (division.fitted, fitted)
        if len(part) < limit:
            part.append(each)
    return division


def _runs(moving: Bool[Tensor, " T"]) -> list[tuple[int, int]]:
    """First and past-the-last row of every stretch of motion."""
    edges = torch.nn.functional.pad(moving.int(), (1, 1)).diff().nonzero().flatten().tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


class _Extras(NamedTuple):
    """What was measured of a track beside its motion."""

    lean: Float[Tensor, " T"] | None
    controls: Float[Tensor, "T m"] | None

    def part(self, rows: slice) -> "_Extras":
        return _Extras(*(None if each is None else each[rows] for each in self))


def _recorded(controls: Tensor | None, like: Bool[Tensor, " T"]) -> Bool[Tensor, " T"]:
    """Where all controls are known."""
    return torch.zeros_like(like) if controls is None else controls.isfinite().all(-1)


def _stretch(name: str, motion: Motion, extras: _Extras, part: slice, dt_s: float) -> Stretch:
    velocity, own = motion.velocity[part], extras.part(part)
    course = motion.heading[part] + torch.atan2(velocity[:, 1], velocity[:, 0])
    turned = wrap_angle(course.diff()).cumsum(0)
    course = torch.cat([course[:1], course[0] + turned])
    return Stretch(
        f"{name}@{part.start * dt_s:.1f}s",
        motion.position[part],
        course,
        velocity.norm(dim=-1),
        own.controls,
        own.lean,
    )
