"""Errors of the models against how hard the human rode."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from diffstack_mmv.plotting.figures import PALETTE, new_figure, save_figure

Interval = Callable[[pd.Series, pd.Series], tuple[float, float]]
"""Of the mean of values over samples, given the recording of each; NaN where it is not known."""


def save_by_excitation(
    path: Path,
    settings: Mapping[str, pd.DataFrame],
    models: list[str],
    axes_of: dict[str, str],
    heading: str,
    interval: Interval,
) -> None:
    """Save `draw_by_excitation`, where there are two models or more to compare."""
    if len(models) > 1:
        save_figure(draw_by_excitation(settings, models, axes_of, heading, interval), path)


def draw_by_excitation(
    settings: Mapping[str, pd.DataFrame],
    models: list[str],
    axes_of: dict[str, str],
    heading: str,
    interval: Interval,
) -> Figure:
    """Draw mean errors over quantiles of the excitation: a row per setting, a column per quantity.

    Args:
        settings: Title -> one row per sample: `recording`, the quantities, and the error of each
            model, NaN where it was not judged.
        models: Columns with errors.
        axes_of: Column of each quantity -> title with its unit.
        heading: Title and unit of the error.
        interval: Of a mean, drawn as a bar where it is known.
    """
    figure = new_figure(4.2 * len(axes_of), 3.2 * max(len(settings), 1))
    for row, (setting, part) in enumerate(settings.items()):
        for column, (name, title) in enumerate(axes_of.items()):
            axes = figure.add_subplot(len(settings), len(axes_of), row * len(axes_of) + column + 1)
            # as many samples in each, so that no point hangs on a handful of them
            group = pd.qcut(part[name], 6, duplicates="drop") if len(part) > 12 else part["mode"]
            ranges = [own for _, own in part.groupby(group, observed=True)]
            for index, model in enumerate(models):
                if part[model].isna().all():
                    continue
                mean = np.array([own[model].mean() for own in ranges])
                ends = np.array([interval(own[model], own["recording"]) for own in ranges])
                axes.errorbar(
                    [own[name].mean() for own in ranges], mean,
                    np.abs(ends.T - mean), label=model,
                    color=PALETTE[index % len(PALETTE)], marker="o", markersize=3, capsize=2,
                )  # fmt: skip
            axes.set(xlabel=title, ylabel=heading)
            axes.set_title(f"{setting}: {len(part)} windows", fontsize=8)
            axes.set_ylim(0, None)
            axes.grid(alpha=0.3)
            axes.legend(fontsize=7)
    return figure
