"""Figures of an evaluation: regions of the forecasts, and errors over the horizon."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from diffstack_mmv.plotting.figures import save_figure
from diffstack_mmv.plotting.horizon import draw_error_over_horizon
from diffstack_mmv.plotting.reliability import draw_reliability

RELIABILITY_FILE = "reliability.png"
OVER_HORIZON_FILE = "error_over_horizon.png"
PLANS_FILE = "plans_{mode}.png"
"""Scenes of one mode with their plans, drawn by who has the stack."""


def save_evaluation(
    folder: Path,
    levels: Mapping[str, np.ndarray],
    errors: Mapping[str, Mapping[str, np.ndarray]],
    dt_s: float,
    heading: str,
    remark: str = "",
) -> None:
    """Write the figures of an evaluation that need no stack into a folder.

    Args:
        folder: The folder.
        levels: Mode -> level of the smallest region that holds each truth.
        errors: Mode -> method -> mean error (T,) in m.
        dt_s: Length of a step.
        heading: Title and unit of the error.
        remark: What the levels are, above their figure.
    """
    save_figure(draw_reliability(levels, remark), folder / RELIABILITY_FILE)
    save_figure(draw_error_over_horizon(errors, dt_s, heading), folder / OVER_HORIZON_FILE)


def remove_evaluation(folder: Path) -> None:
    """Remove the figures of an earlier evaluation, perhaps of modes that are no longer judged."""
    plans = folder.glob(PLANS_FILE.format(mode="*"))
    for earlier in (*plans, folder / RELIABILITY_FILE, folder / OVER_HORIZON_FILE):
        earlier.unlink(missing_ok=True)
