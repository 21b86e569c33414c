"""How errors grow over the horizon."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from diffstack_mmv.plotting.figures import PALETTE, new_figure

OURS = {"prediction": 4.0, "plan": 1.8}
"""Widths of the lines of the stack: a plan that does as its prediction does not hide it."""


def draw_error_over_horizon(
    errors: Mapping[str, Mapping[str, np.ndarray]], dt_s: float, heading: str
) -> Figure:
    """Draw the mean distance to the human over the horizon: a panel per mode, a line per method.

    Args:
        errors: Mode -> method -> mean error (T,) in m.
        dt_s: Length of a step in s.
        heading: Title and unit of the error.
    """
    figure = new_figure(4.2 * max(len(errors), 1), 3.6)
    for column, (mode, methods) in enumerate(errors.items()):
        axes = figure.add_subplot(1, len(errors), column + 1)
        for index, (name, error) in enumerate(methods.items()):
            width = OURS.get(name)
            time_s = dt_s * np.arange(1, len(error) + 1)
            axes.plot(
                time_s,
                error,
                color=PALETTE[index % len(PALETTE)],
                linewidth=width or 1.1,
                linestyle="-" if width else "--",
                label=name.replace("_", " "),
            )
        axes.set(title=mode, xlabel="time ahead [s]", ylabel=heading)
        axes.set_ylim(0, None)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
    return figure
