"""Tracks as they come in, sampled up to now as a conversion would sample them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from data_converters.believed import Believed, Samples
from data_converters.errors import require
from data_converters.heading import heading_from_motion
from data_converters.limits import RecordingLimits
from data_converters.modes import usual_size
from data_converters.tracks import ResampleSettings
from dmmv_conventions.checks import is_number
from dmmv_conventions.modes import Mode
from dmmv_conventions.observed import ObservedAgents

Array = NDArray[np.float64]

COLUMNS = ("time", "agent", "mode", "x", "y")
SIZE = ("length", "width")
NUMBERS = ("time", "x", "y", *SIZE)


class _Sampled(NamedTuple):
    position: Array  # H 2, m
    velocity: Array  # H 2, m/s
    heading: Array  # H, rad


@dataclass(frozen=True)
class LiveTracks:
    """Smooths and samples what was observed so far, for a stack that decides now.

    A row of an agent is that of a conversion with the same settings: the smoother sees no later
    sample than the row. An agent whose last sample is not much older than now is taken to move on
    as its smoothed track does; one that is older is absent now.

    Attributes:
        settings: Step, longest gap, standstill and smoother, as of the conversion of the training
            data; its `min_duration_s` plays no part.
        late_s: How old the last sample of an agent may be.
        limits: Speeds that are believed, as of a conversion. A single sample that jumps is left
            out; a track that jumps for good begins anew there.

    Raises:
        ConversionError: The smoother looks ahead, `late_s` is negative, or settings or limits are
            something else.
    """

    settings: ResampleSettings = field(default_factory=ResampleSettings)
    late_s: float = 0.15
    limits: RecordingLimits = field(default_factory=RecordingLimits)

    def __post_init__(self) -> None:
        for name, kind in (("settings", ResampleSettings), ("limits", RecordingLimits)):
            found = getattr(self, name)
            require(isinstance(found, kind), name, f"be {kind.__name__}", type(found).__name__)
        ahead = self.settings.smoother.lookahead_s
        remedy = "Use CausalSmoother()."
        require(ahead == 0.0, "smoother", "not look ahead", f"{ahead:g} s", "", remedy)
        known = is_number(self.late_s) and self.late_s >= 0.0
        require(known, "late_s", "be at least 0", self.late_s)

    def __call__(
        self,
        table: pd.DataFrame,
        ego: str | int,
        history_s: float = 4.0,
        now_s: float | None = None,
    ) -> ObservedAgents:
        """Sample the agents of a table.

        Args:
            table: One row per agent and time, in any order: `time` in s on one clock, `agent`,
                `mode` (such as bicycle), `x` and `y` in m; `length` and `width` in m, NaN where
                they were not measured. A few seconds more than `history_s` are enough.
            ego: Name of the agent that decides.
            history_s: Length of the past, a multiple of the step.
            now_s: The present; by default the time of the last sample of the ego. Later samples are
                left out.

        Returns:
            The ego, and all others that are present now, in the order of the table.

        Raises:
            ConversionError: The table is no DataFrame, a column is missing, a value is none of its
                kind, an agent has two samples of one time or two modes, or the ego is not present
                now, faster than its mode, or seen so rarely that its times are no seconds.
        """
        _require_columns(table)
        names, ego = table["agent"].astype(str), str(ego)
        known = (names == ego).any()
        told = ", ".join(sorted(names.unique())[:5]) or "no agents"
        require(bool(known), "ego", f"be an agent of the table, such as {told}", ego)
        now = _now(table.loc[names == ego, "time"], now_s)
        rows = self._rows(history_s)
        stretches = self._stretches(_samples(table, names, now), ego)
        order = [ego, *(name for name in stretches if name != ego)]
        tracks = {name: self._sampled(stretches.get(name), rows) for name in order}
        present = {name: track for name, track in tracks.items() if track is not None}
        require(
            ego in present,
            "ego",
            f"be observed for {self.settings.smoother.warmup_s:g} s and more, "
            f"up to {self.late_s:g} s before {now:g} s",
            ego,
            remedy="Wait for more samples, or raise `late_s`.",
        )
        return self._observed(present, stretches, ego)

    def _stretches(self, seen: Mapping[str, Samples], ego: str) -> dict[str, Samples]:
        """The last stretch of each agent that is present now, without samples that jump."""
        believed = Believed(self.limits, self.settings.max_gap_s)
        stretches = {
            name: believed.stretch(samples, f"the track of {name!r}")
            for name, samples in seen.items()
            if samples.time_s[-1] >= self._oldest_s
        }
        # one is enough to tell; no decision ends because of what a tracker makes of somebody else
        if ego in seen:
            believed.require_metres(seen[ego], f"the track of {ego!r}")
            if ego not in stretches or len(stretches[ego].time_s) == 1:
                believed.require_seconds(seen[ego], f"the track of {ego!r}")
        return stretches

    def _observed(
        self, present: Mapping[str, _Sampled], stretches: Mapping[str, Samples], ego: str
    ) -> ObservedAgents:
        """All who are present, of whom the ego is no faster than its mode can be."""
        modes = {name: _mode(stretches[name], name) for name in present}
        velocity = present[ego].velocity
        known = np.isfinite(velocity).all(axis=1)
        self.limits.check_smoothed(velocity[known], modes[ego], f"the track of {ego!r}")
        columns = zip(*present.values(), strict=True)
        position, velocity, heading = (np.stack(column) for column in columns)
        return ObservedAgents(
            names=tuple(present),
            modes=tuple(mode.label for mode in modes.values()),
            extent=np.stack([_extent(stretches[name], mode) for name, mode in modes.items()]),
            position=position,
            velocity=velocity,
            heading=heading,
            dt_s=self.settings.dt_s,
        )

    def _rows(self, history_s: float) -> int:
        steps = history_s / self.settings.dt_s if is_number(history_s) else 0.0
        whole = 1.0 - 1e-6 <= steps < np.inf and abs(steps - round(steps)) < 1e-6
        require(whole, "history_s", f"be a multiple of {self.settings.dt_s:g} s", history_s)
        return round(steps) + 1

    @property
    def _oldest_s(self) -> float:
        """Time of the last sample of whoever is present now, at least."""
        return -self.late_s - 1e-9

    def _sampled(self, samples: Samples | None, rows: int) -> _Sampled | None:
        """A stretch, with NaN before its start; None if it is absent now."""
        if samples is None:
            return None
        time_s = samples.time_s
        smoother, dt_s = self.settings.smoother, self.settings.dt_s
        late = time_s[-1] < self._oldest_s
        if late or len(time_s) < smoother.samples_needed:
            return None
        # from the start of the stretch on: a heading is held for as long as the agent stands
        first = int(np.ceil(smoother.ready_s(time_s) / dt_s - 1e-6))
        at_s = dt_s * np.arange(first, 1)
        if len(at_s) == 0:
            return None
        smooth = smoother(time_s, samples.place, at_s)
        heading = heading_from_motion(smooth.rate, self.settings.standstill_mps, backfill=False)
        found = np.column_stack([smooth.value, smooth.rate, heading.angle])[-rows:]
        sampled = np.full((rows, found.shape[1]), np.nan)
        sampled[rows - len(found) :] = found
        return _Sampled(sampled[:, :2], sampled[:, 2:4], sampled[:, 4])


def _require_columns(table: pd.DataFrame) -> None:
    remedy = f"Make one with the columns {', '.join(COLUMNS)}."
    framed, found = isinstance(table, pd.DataFrame), type(table).__name__
    require(framed, "table", "be a DataFrame of pandas", found, "", remedy)
    absent = [name for name in COLUMNS if name not in table]
    have = ", ".join(map(str, table.columns))
    require(not absent, "table", f"have the columns {', '.join(COLUMNS)}", have)
    nameless = int(table["agent"].isna().sum())
    remedy = "Leave those rows out."
    require(nameless == 0, "agent", "be given in all rows", f"{nameless} without", "", remedy)
    for name in NUMBERS:
        if name not in table:
            continue
        number = pd.api.types.is_numeric_dtype(table[name])
        require(number, name, "hold numbers", table[name].dtype, "the table")
        values = table[name].to_numpy(float)
        unusable = np.isinf(values) if name in SIZE else ~np.isfinite(values)
        lost = int(unusable.sum())
        require(lost == 0, name, "be finite in all rows", f"{lost} that are not", "", remedy)


def _now(times: pd.Series, now_s: float | None) -> float:
    """The present: what is given, or the last time of the ego."""
    now = float(times.max()) if now_s is None else now_s
    there = is_number(now) and np.isfinite(now)
    require(bool(there), "now_s", "be a finite time in s", now)
    return now


def _samples(table: pd.DataFrame, names: pd.Series, now_s: float) -> dict[str, Samples]:
    """Samples of each agent up to now, with times since then, in the order of the table."""
    # seconds since 1970 resolve a quarter of a microsecond: a sample at a row stays there
    time_s = (table["time"].to_numpy(float) - now_s).round(6)
    size = table[list(SIZE)].to_numpy(float) if all(name in table for name in SIZE) else None
    place, modes = table[["x", "y"]].to_numpy(float), table["mode"].astype(str).to_numpy(object)
    agent, labels = pd.factorize(names)
    order = np.lexsort((time_s, agent))
    order = order[time_s[order] <= 0.0]
    sorted_samples = Samples(time_s, place, modes, size).taken(order)
    begins = np.searchsorted(agent[order], np.arange(len(labels) + 1))
    return {
        str(label): sorted_samples.taken(slice(begin, end))
        for label, begin, end in zip(labels, begins[:-1], begins[1:], strict=True)
        if end > begin
    }


def _mode(samples: Samples, name: str) -> Mode:
    told = sorted(set(samples.modes))
    where = f"the track of {name!r}"
    require(len(told) == 1, "mode", "be the same in all rows", " and ".join(told), where)
    return Mode.named(told[0])


def _extent(samples: Samples, mode: Mode) -> Array:
    """The size that was measured last, as converters the usual one of the mode where none was."""
    length_m, width_m, _ = usual_size(mode)
    usual = np.array([length_m, width_m])
    if samples.size is None:
        return usual
    measured = pd.DataFrame(samples.size).ffill().to_numpy()[-1]
    size = np.where(np.isnan(measured), usual, measured)
    require(bool((size > 0.0).all()), "length, width", "be positive", size.tolist())
    return size
