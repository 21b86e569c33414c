"""Figures of an identification: tracks and fits, controls, lean, and what is known by them."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from diffstack_mmv.plotting.estimates import (
    Estimate,
    draw_estimates,
    draw_profiles,
    draw_spectrum,
)
from diffstack_mmv.plotting.figures import PALETTE, control_title, new_figure, save_figure

Array = NDArray[np.float64]

DASHES = ("-", "--", ":", "-.")
"""Of lines, in turn, once every colour is in use."""
LEGEND_ROWS = 40
"""Most names in a column of a legend."""


class FittedTrack(NamedTuple):
    """One track beside the motion fitted to it."""

    name: str
    recorded: Array  # T+1 2, m
    fitted: Array  # T+1 2, m
    controls: Array  # T m
    lean: Array | None = None  # T+1, rad, of the model
    recorded_lean: Array | None = None  # T+1, rad


def draw_tracks(tracks: Sequence[FittedTrack], columns: int = 6) -> Figure:
    """Draw each track (dots) and its fit (line) in a panel of its own."""
    columns = min(columns, len(tracks))
    rows = math.ceil(len(tracks) / columns)
    figure = new_figure(2.1 * columns, 2.1 * rows + 0.2)
    for index, track in enumerate(tracks):
        axes = figure.add_subplot(rows, columns, index + 1)
        # once for all panels
        recorded, fit = ("recorded", "fit") if index == 0 else ("_", "_")
        axes.plot(*track.recorded.T, ".", color=PALETTE[0], markersize=3, label=recorded)
        axes.plot(*track.fitted.T, color=PALETTE[1], linewidth=1, label=fit)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(track.name, fontsize=5)
        axes.tick_params(labelsize=5)
    figure.supxlabel("x [m]", fontsize=8)
    figure.supylabel("y [m]", fontsize=8)
    figure.legend(loc="outside upper center", fontsize=6, ncols=2)
    return figure


def draw_controls(tracks: Sequence[FittedTrack], names: Sequence[str], dt_s: float) -> Figure:
    """Draw the inferred controls of all tracks over time, one panel per control.

    Args:
        tracks: The tracks; the legend names them.
        names: Names of the controls.
        dt_s: Length of a step in s.
    """
    figure = new_figure(9.0, 2.4 * len(names))
    for row, name in enumerate(names):
        axes = figure.add_subplot(len(names), 1, row + 1)
        for index, track in enumerate(tracks):
            time_s, held = dt_s * np.arange(len(track.controls)), track.controls[:, row]
            turn, color = divmod(index, len(PALETTE))
            (line,) = axes.step(time_s, held, where="post", color=PALETTE[color], linewidth=0.8)
            line.set_linestyle(DASHES[turn % len(DASHES)])
            # once for all panels
            line.set_label(track.name if row == 0 else "_")
        axes.set_ylabel(control_title(name))
        axes.grid(alpha=0.3)
    figure.supxlabel("time [s]", fontsize=9)
    columns = max(1, math.ceil(len(tracks) / LEGEND_ROWS))
    figure.legend(
        loc="outside right upper", fontsize=5, title="track", title_fontsize=6, ncols=columns
    )
    return figure


def draw_lean(tracks: Sequence[FittedTrack], dt_s: float) -> Figure:
    """Draw the lean of the model beside the measured one, which the fit does not use."""
    shown = [each for each in tracks if each.lean is not None and each.recorded_lean is not None]
    figure = new_figure(7.0, 1.7 * max(len(shown), 1))
    for index, each in enumerate(shown):
        axes = figure.add_subplot(len(shown), 1, index + 1)
        for lean, label, color in (
            (each.recorded_lean, "measured", PALETTE[0]),
            (each.lean, "model", PALETTE[1]),
        ):
            if lean is not None:
                time_s = dt_s * np.arange(len(lean))
                axes.plot(time_s, np.rad2deg(lean), color=color, label=label, linewidth=1)
        axes.set_ylabel("lean [deg]", fontsize=7)
        axes.set_title(each.name, fontsize=6)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=6)
    figure.supxlabel("time [s]", fontsize=8)
    return figure


def save_identification(
    folder: Path,
    result: Mapping[str, Any],
    tracks: Sequence[FittedTrack],
    controls: Sequence[str],
    dt_s: float,
) -> None:
    """Write all figures of an identification into a folder.

    Args:
        folder: The folder.
        result: Content of `identification.json`.
        tracks: Fitted tracks.
        controls: Names of the controls.
        dt_s: Length of a step.
    """
    save_figure(draw_tracks(tracks), folder / "tracks.png")
    save_figure(draw_controls(tracks, controls, dt_s), folder / "controls.png")
    if result["parameters"]:
        known = [name for name in Estimate._fields if name != "name"]
        estimates = [
            Estimate(name, **{key: entry[key] for key in known})
            for name, entry in result["parameters"].items()
        ]
        save_figure(draw_estimates(estimates), folder / "parameters.png")
        save_figure(draw_spectrum(result["eigenvalues"]), folder / "spectrum.png")
    if result.get("profiles"):
        profiles = {
            name: (np.array(each["values"]), np.array(each["costs"]))
            for name, each in result["profiles"].items()
        }
        save_figure(draw_profiles(profiles), folder / "profiles.png")
    if any(track.lean is not None and track.recorded_lean is not None for track in tracks):
        save_figure(draw_lean(tracks, dt_s), folder / "lean.png")
