"""Whether regions of a forecast hold as many truths as they should."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from diffstack_mmv.plotting.figures import PALETTE, new_figure


def draw_reliability(levels: Mapping[str, np.ndarray], title: str = "") -> Figure:
    """Draw the share of the truths in the region of each probability, a line per mode.

    A calibrated forecast is on the diagonal, one that is too sure below it.

    Args:
        levels: Mode -> level of the smallest region that holds each truth, of shape (n,); above 1
            beyond all samples of the forecast.
        title: Above the axes.
    """
    figure = new_figure(4.2, 4.0)
    axes = figure.add_subplot(1, 1, 1)
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=1, linestyle="--", label="calibrated")
    # the region of probability 1 is the whole plane, whatever samples reach
    nominal = np.linspace(0, 1, 41)[1:-1]
    for index, (mode, own) in enumerate(levels.items()):
        observed = [(own <= region).mean() for region in nominal]
        axes.plot(nominal, observed, color=PALETTE[index % len(PALETTE)], linewidth=2, label=mode)
    axes.set(xlabel="probability of the region", ylabel="truths inside", xlim=(0, 1), ylim=(0, 1))
    axes.set_title(title, fontsize=9)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return figure
