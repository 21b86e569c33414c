"""Errors of the models against how hard the human rode."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from diffstack_mmv.plotting.figures import PALETTE, new_figure, save_figure


def save_by_excitation(
    path: Path, samples: pd.DataFrame, models: list[str], axes_of: dict[str, str], heading: str
) -> None:
    """Save `draw_by_excitation`, where there are two models or more to compare."""
    if len(models) > 1:
        save_figure(draw_by_excitation(samples, models, axes_of, heading), path)


def draw_by_excitation(
    samples: pd.DataFrame, models: list[str], axes_of: dict[str, str], heading: str
) -> Figure:
    """Draw mean errors over quantiles of the excitation: a row per mode, a column per quantity.

    Args:
        samples: One row per sample: `mode`, the quantities, and the error of each model.
        models: Columns with errors.
        axes_of: Column of each quantity -> title with its unit.
        heading: Title and unit of the error.
    """
    modes = sorted(set(samples["mode"]))
    figure = new_figure(4.2 * len(axes_of), 3.2 * max(len(modes), 1))
    for row, mode in enumerate(modes):
        part = samples[samples["mode"] == mode]
        for column, (name, title) in enumerate(axes_of.items()):
            axes = figure.add_subplot(len(modes), len(axes_of), row * len(axes_of) + column + 1)
            # as many samples in each, so that no point hangs on a handful of them
            group = pd.qcut(part[name], 6, duplicates="drop") if len(part) > 12 else part["mode"]
            for index, model in enumerate(models):
                told = part.groupby(group, observed=True).agg(
                    {name: "mean", model: ["mean", "sem"]}
                )
                error = 1.96 * np.nan_to_num(told[(model, "sem")].to_numpy())
                axes.errorbar(
                    told[(name, "mean")], told[(model, "mean")], error, label=model,
                    color=PALETTE[index % len(PALETTE)], marker="o", markersize=3, capsize=2,
                )  # fmt: skip
            axes.set(title=f"{mode}, {len(part)} windows", xlabel=title, ylabel=heading)
            axes.set_ylim(0, None)
            axes.grid(alpha=0.3)
            axes.legend(fontsize=7)
    return figure
