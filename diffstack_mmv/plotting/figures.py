"""What all figures share: one palette, and saving without a display."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dmmv_conventions.disk import replacing

# Okabe and Ito's palette, which people with any colour vision can tell apart
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")

CONTROL_UNITS = {
    "acceleration": "m/s²",
    "steer": "rad",
    "yaw_rate": "rad/s",
    "velocity_x": "m/s",
    "velocity_y": "m/s",
}


def control_title(name: str) -> str:
    """Name of a control with its unit, where that is known."""
    return f"{name} [{CONTROL_UNITS[name]}]" if name in CONTROL_UNITS else name


def new_figure(width: float = 6.0, height: float = 4.0) -> Figure:
    """Make a figure (inches) that needs no display and touches no global state."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure atomically, in the format of the ending of the path."""
    with replacing(path) as unfinished:
        figure.savefig(unfinished, dpi=130, format=path.suffix.removeprefix("."))
