"""Figures of what an identification knows: parameters, information, profile likelihoods."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from diffstack_mmv.plotting.figures import PALETTE, new_figure

Array = NDArray[np.float64]

NO_INFORMATION = 1e-6
"""Information of tracks over that of the prior below which it is none.

It takes less than a millionth off the deviation of the prior; what is far below is rounding alone.
"""


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
        marker = "s" if each.verdict == "identifiable" else "x"
        axes.errorbar(found, row - 0.15, xerr=narrow, color=PALETTE[1], fmt=marker, markersize=4)
    ends = [f"{e.name} [{e.unit}]\n{e.low:.3g} … {e.high:.3g}" for e in estimates]
    axes.set_yticks(range(len(estimates)), labels=ends, fontsize=6)
    axes.set(xlim=(-0.02, 1.02), xlabel="position in the range")
    axes.set_ylim(len(estimates) - 0.5, -0.5)  # the first on top, and room around a single one
    told = "prior (circle), estimate (square: identifiable, cross: not), 2 deviations"
    axes.set_title(told, fontsize=8)
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
