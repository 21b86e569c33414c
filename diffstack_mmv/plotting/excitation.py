"""Errors of the models against how hard the human rode."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from diffstack_mmv.plotting.figures import PALETTE, new_figure, save_figure

SETTING = ("data", "split", "goal", "mode", "vehicle")
"""Columns by which samples are told apart, a row of axes for each."""


def save_by_excitation(
    path: Path, samples: pd.DataFrame, models: list[str], axes_of: dict[str, str], heading: str
) -> None:
    """Save `draw_by_excitation`, where there are two models or more to compare."""
    if len(models) > 1:
        save_figure(draw_by_excitation(samples, models, axes_of, heading), path)


def draw_by_excitation(
    samples: pd.DataFrame, models: list[str], axes_of: dict[str, str], heading: str
) -> Figure:
    """Draw mean errors over quantiles of the excitation: a row per setting, a column per quantity.

    Bars are intervals of 95 %, from how much the recordings differ (their sums of deviations, since
    windows of one recording resemble each other); none with a single recording.

    Args:
        samples: One row per sample: `SETTING`, `scene`, the quantities, and the error of each
            model, NaN where it was not judged.
        models: Columns with errors.
        axes_of: Column of each quantity -> title with its unit.
        heading: Title and unit of the error.
    """
    settings = list(samples.groupby(list(SETTING)))
    figure = new_figure(4.2 * len(axes_of), 3.2 * max(len(settings), 1))
    for row, (setting, part) in enumerate(settings):
        told = f"{', '.join(map(str, setting))}: {len(part)} windows"
        for column, (name, title) in enumerate(axes_of.items()):
            axes = figure.add_subplot(len(settings), len(axes_of), row * len(axes_of) + column + 1)
            # as many samples in each, so that no point hangs on a handful of them
            group = pd.qcut(part[name], 6, duplicates="drop") if len(part) > 12 else part["mode"]
            ranges = [own for _, own in part.groupby(group, observed=True)]
            for index, model in enumerate(models):
                if part[model].isna().all():
                    continue
                axes.errorbar(
                    [own[name].mean() for own in ranges], [own[model].mean() for own in ranges],
                    [_half_width(own[model], own["scene"]) for own in ranges], label=model,
                    color=PALETTE[index % len(PALETTE)], marker="o", markersize=3, capsize=2,
                )  # fmt: skip
            axes.set(xlabel=title, ylabel=heading)
            axes.set_title(told, fontsize=8)
            axes.set_ylim(0, None)
            axes.grid(alpha=0.3)
            axes.legend(fontsize=7)
    return figure


def _half_width(values: pd.Series, recordings: pd.Series) -> float:
    """Half of the interval of 95 % of a mean, 0 with a single recording."""
    sums = (values - values.mean()).groupby(recordings).sum().to_numpy()
    if len(sums) < 2:
        return 0.0
    spread = np.square(sums).sum() * len(sums) / (len(sums) - 1)
    return float(1.96 * np.sqrt(spread) / len(values))
