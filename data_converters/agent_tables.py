"""Tables of the samples of many agents, made into tracks: who can be used, and who is counted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from data_converters.errors import RejectReason, TrackError, fault, refuse_track
from data_converters.limits import SIZES, on_one_clock
from data_converters.modes import default_extent
from data_converters.recordings import RawScene
from data_converters.tracks import RawTrack
from dmmv_conventions.modes import Mode

if TYPE_CHECKING:
    from trajdata.data_structures.agent import FixedExtent

LONGEST_HOLD_S = 0.5
"""For how long a heading that is missing is that of before."""

SAME_PLACE_M = 1.0
"""Distance of two samples of the same time up to which they may be of one agent."""


def named_agents(table: pd.DataFrame, source: str, raw: RawScene, *, strict: bool) -> pd.DataFrame:
    """Samples whose agent has a name; the others, who may be several, are counted.

    Raises:
        TrackError: When `strict`.
    """
    unnamed = table["agent"].isna() if len(table) else pd.Series(dtype=bool)
    if not unnamed.any():
        return table
    found = f"none in {int(unnamed.sum())} of {len(table)} rows"
    remedy = "Name it in every row; in a text file NA, null, None and nan are no names."
    told = fault("agent", "have a name", found, source, remedy)
    raw.reject("unnamed", source, TrackError(told, RejectReason.NO_AGENT), strict=strict)
    return table[~unnamed]


def on_shared_clock(
    table: pd.DataFrame, span_s: float, raw: RawScene, *, strict: bool
) -> pd.DataFrame:
    """Samples of the agents that share a clock; who is years away would move all others.

    Args:
        table: Samples of all agents; `source` is the file of each.
        span_s: Longest time in s from the first sample to the last.
        raw: The scene, in which the others are counted.
        strict: Raise instead.

    Raises:
        TrackError: When `strict`.
    """
    times = table["time_s"].where(np.isfinite(table["time_s"])).groupby(table["agent"])
    first, last = times.min().dropna(), times.max().dropna()
    if len(first) == 0 or last.max() - first.min() <= span_s:
        return table
    begin, end = ({str(n): float(t) for n, t in each.items()} for each in (first, last))
    kept = on_one_clock(begin, end, span_s)
    for name in sorted(begin.keys() - kept):
        source = str(table["source"][table["agent"] == name].iloc[0])
        needs = f"be within {span_s:g} s of the other agents"
        remedy = "Correct the clock, or raise `span_s`."
        if end[name] - begin[name] > span_s:
            needs = f"cover at most {span_s:g} s for one agent"
            remedy = "Name its trips apart, or raise `span_s`."
        found = f"{begin[name]:g} to {end[name]:g} s"
        try:
            where = f"{source}, agent {name}"
            refuse_track(RejectReason.TIME_SPAN, "time_s", needs, found, where, remedy)
        except TrackError as error:
            raw.reject(name, source, error, strict=strict)
    # without a clock an agent is refused by itself
    return table[~table["agent"].isin(begin.keys() - kept)]


def add_tracks(raw: RawScene, table: pd.DataFrame, *, strict: bool) -> None:
    """Add every agent of a table to a scene, or count why not.

    Args:
        raw: The scene.
        table: As `MultiAgentDataset.table` returns it, time 0 being that of the scene; `source` is
            the file of a sample.
        strict: Raise at the first bad track.

    Raises:
        TrackError: When `strict`.
    """
    for name, rows in table.groupby("agent", sort=True):
        source = str(rows["source"].iloc[0])
        try:
            raw.tracks.append(_track(str(name), rows, source, raw))
        except TrackError as error:
            raw.reject(str(name), source, error, strict=strict)


def _track(name: str, rows: pd.DataFrame, source: str, raw: RawScene) -> RawTrack:
    where = f"{source}, agent {name}"
    mode = _mode(rows, where)
    needed = [column for column in ("time_s", "x", "y", "z", "id") if column in rows]
    values = rows[needed].to_numpy(np.float64)
    bad = ~np.isfinite(values).all(axis=1)
    if bad.any():
        needs, remedy = "be finite numbers", "Correct or remove the row."
        found = values[int(bad.argmax())]
        told = rows.iloc[int(bad.argmax())].get("fault")
        if isinstance(told, str):
            raise TrackError(told, RejectReason.NOT_FINITE)
        refuse_track(RejectReason.NOT_FINITE, ", ".join(needed), needs, found, where, remedy)
    rows = _in_order(rows, where, raw)
    height = rows["z"] if "z" in rows else np.zeros(len(rows))
    return RawTrack(
        name=name,
        mode=mode,
        time_s=rows["time_s"].to_numpy(np.float64),
        position=np.column_stack([rows["x"], rows["y"], height]).astype(np.float64),
        source=source,
        extent=_extent(rows, mode),
        speed=_optional(rows, "speed"),
        heading=_heading(rows, raw),
    )


def _in_order(rows: pd.DataFrame, where: str, raw: RawScene) -> pd.DataFrame:
    """One sample per time, the first of it, in the order of time."""
    rows = rows.sort_values("time_s", kind="stable")
    time_s, x, y = (rows[name].to_numpy(np.float64) for name in ("time_s", "x", "y"))
    fresh = np.concatenate([[True], np.diff(time_s) > 0.0])
    if len(rows) > 1 and fresh.sum() == 1:
        needs, remedy = "increase", "The agent has no clock."
        refuse_track(RejectReason.REPEATED_TIMESTAMPS, "time_s", needs, time_s[:2], where, remedy)
    first = np.maximum.accumulate(np.where(fresh, np.arange(len(rows)), 0))
    apart = np.hypot(x - x[first], y - y[first])
    if apart.max() > SAME_PLACE_M:
        needs, remedy = "be in one place at a time", "Name agents apart, or remove one of the rows."
        found = f"two {apart.max():.3g} m apart, {time_s[apart.argmax()]:g} s from the beginning"
        refuse_track(RejectReason.TWO_PLACES, "agent", needs, found, where, remedy)
    raw.note("repeated_timestamps", int((~fresh).sum()))
    return rows[fresh]


def _mode(rows: pd.DataFrame, where: str) -> Mode:
    modes = rows["mode"].unique()
    known = np.isfinite(modes)
    if len(modes) != 1 or not known.all():
        labels = sorted({str(label) for label in rows.get("label", rows["mode"])})
        needs, remedy = "be one known class for all rows of an agent", "Map it to a mode."
        if known.all():
            remedy = "Give it one class, or another name to each of several agents."
        elif "advice" in rows:
            remedy = str(rows["advice"][rows["mode"].isna()].iloc[0])
        refuse_track(RejectReason.UNKNOWN_CLASS, "type", needs, ", ".join(labels), where, remedy)
    return Mode(int(modes[0]))


def _heading(rows: pd.DataFrame, raw: RawScene) -> NDArray[np.float64] | None:
    """The recorded heading; where it is missing for a moment, the last one, which looks not ahead.

    An agent that lacks it for longer, or from the start on, is counted, and faces where it goes.
    """
    if "heading" not in rows:
        return None
    values, time_s = (rows[name].to_numpy(np.float64) for name in ("heading", "time_s"))
    known = np.isfinite(values)
    latest = np.maximum.accumulate(np.where(known, np.arange(len(values)), 0))
    usable = known[0] and (time_s - time_s[latest]).max() <= LONGEST_HOLD_S
    raw.note("headings_held", int(usable) * int((~known).sum()))
    raw.note("agents_with_unusable_headings", int(known.any() and not usable))
    return values[latest] if usable else None


def _optional(rows: pd.DataFrame, column: str) -> NDArray[np.float64] | None:
    """A column, if every row of the agent has a finite number in it."""
    if column not in rows:
        return None
    values = rows[column].to_numpy(np.float64)
    return values if np.isfinite(values).all() else None


def _extent(rows: pd.DataFrame, mode: Mode) -> FixedExtent | None:
    """Median of the stated sizes; what is not stated is the usual one of the mode."""
    from trajdata.data_structures.agent import FixedExtent

    usual = default_extent(mode)
    stated = [
        float(rows[column].dropna().median()) if column in rows else float("nan")
        for column in SIZES
    ]
    if not np.isfinite(stated).any():
        return None
    filled = zip(stated, (usual.length, usual.width, usual.height), strict=True)
    return FixedExtent(*(own if np.isfinite(own) else default for own, default in filled))
