"""Figures of an identification: tracks and fits, controls, parameters, information, lean."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from diffstack_mmv.plotting.figures import PALETTE, control_title, new_figure, save_figure

Array = NDArray[np.float64]

DASHES = ("-", "--", ":", "-.")
"""Of lines, in turn, once every colour is in use."""
LEGEND_ROWS = 40
"""Most names in a column of a legend."""
NO_INFORMATION = 1e-6
"""Information of tracks over that of the prior below which it is none.

It takes less than a millionth off the deviation of the prior; what is far below is rounding alone.
"""


class FittedTrack(NamedTuple):
    """One track beside the motion fitted to it."""

    name: str
    recorded: Array  # T+1 2, m
    fitted: Array  # T+1 2, m
    controls: Array  # T m
    lean: Array | None = None  # T+1, rad, of the model
    recorded_lean: Array | None = None  # T+1, rad


class Estimate(NamedTuple):
    """A parameter with its prior."""

    name: str
    unit: str
    initial: float
    prior_std: float
    low: float
    high: float
    estimate: float
    std: float
    verdict: str


def draw_tracks(tracks: Sequence[FittedTrack], columns: int = 6) -> Figure:
    """Draw each track (dots) and its fit (line) in a panel of its own."""
    rows = math.ceil(len(tracks) / columns)
    figure = new_figure(2.1 * columns, 2.1 * rows)
    for index, track in enumerate(tracks):
        axes = figure.add_subplot(rows, columns, index + 1)
        axes.plot(*track.recorded.T, ".", color=PALETTE[0], markersize=3)
        axes.plot(*track.fitted.T, color=PALETTE[1], linewidth=1)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(track.name, fontsize=5)
        axes.tick_params(labelsize=5)
    figure.supxlabel("x [m]", fontsize=8)
    figure.supylabel("y [m]", fontsize=8)
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


def draw_estimates(estimates: Sequence[Estimate]) -> Figure:
    """Draw prior and posterior of each parameter over its range, two standard deviations wide."""
    figure = new_figure(7.0, 0.8 + 0.38 * len(estimates))
    axes = figure.add_subplot()
    for row, each in enumerate(estimates):
        span = each.high - each.low
        prior, found = (each.initial - each.low) / span, (each.estimate - each.low) / span
        wide, narrow = 2 * each.prior_std / span, 2 * each.std / span
        axes.plot([0, 1], [row, row], color="0.9", linewidth=9, solid_capstyle="butt", zorder=0)
        axes.errorbar(prior, row + 0.15, xerr=wide, color=PALETTE[0], fmt="o", markersize=4)
        told = each.verdict == "identifiable"
        marker = "s" if told else "x"
        axes.errorbar(found, row - 0.15, xerr=narrow, color=PALETTE[1], fmt=marker, markersize=4)
    ends = [f"{e.name} [{e.unit}]\n{e.low:.3g} … {e.high:.3g}" for e in estimates]
    axes.set_yticks(range(len(estimates)), labels=ends, fontsize=6)
    axes.set(xlim=(-0.02, 1.02), xlabel="position in the range")
    axes.set_ylim(len(estimates) - 0.5, -0.5)  # the first on top, and room around a single one
    axes.set_title("prior (circle), estimate (square: identifiable), 2 deviations", fontsize=8)
    return figure


def draw_spectrum(eigenvalues: Sequence[float]) -> Figure:
    """Draw the eigenvalues of the information in units of that of the priors; 1 is as much.

    Those below `NO_INFORMATION` are marked at the lower edge as such, not drawn with a value.
    """
    figure = new_figure(5.0, 3.2)
    axes = figure.add_subplot()
    order, values = np.arange(1, len(eigenvalues) + 1), np.array(eigenvalues)
    told = values >= NO_INFORMATION
    axes.semilogy(order[told], values[told], "o", color=PALETTE[0])
    if not told.all():
        floor, label = np.full((~told).sum(), NO_INFORMATION), f"none: below {NO_INFORMATION:g}"
        axes.semilogy(order[~told], floor, "v", color=PALETTE[0], fillstyle="none", label=label)
    axes.axhline(1.0, color=PALETTE[1], linestyle="--", label="information of the prior")
    axes.set(xlabel="direction", ylabel="information of the tracks / prior", xticks=order)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7)
    return figure


def draw_profiles(profiles: Mapping[str, tuple[Array, Array]]) -> Figure:
    """Draw profile likelihoods: least cost over each fixed value, above the least of all.

    Args:
        profiles: Values (k,) and costs (k,) by the name of the parameter.
    """
    figure = new_figure(3.4 * max(len(profiles), 1), 3.0)
    for index, (name, (values, costs)) in enumerate(profiles.items()):
        axes = figure.add_subplot(1, len(profiles), index + 1)
        axes.plot(values, costs - costs.min(), "o-", color=PALETTE[0], markersize=3)
        axes.axhline(2.0, color=PALETTE[1], linestyle="--", label="2 deviations")
        axes.set(xlabel=name, ylabel="cost above the least")
        axes.legend(fontsize=7)
        axes.grid(alpha=0.3)
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
