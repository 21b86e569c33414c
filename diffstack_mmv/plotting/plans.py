"""A plan beside what the human did."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diffstack_mmv.plotting.figures import PALETTE, new_figure

ASPECT = 0.75  # height of a panel by its width
MARGIN_M = 1.0
FAINTEST = 0.3  # opacity of the lightest component; the heaviest has 1, however many there are


class PlannedScene(NamedTuple):
    """One sample to draw, positions in m in the frame of the ego."""

    title: str
    past: np.ndarray  # H 2
    human: np.ndarray  # T 2
    plan: np.ndarray  # T 2
    prediction: np.ndarray  # T 2, the one path of the forecast, which is scored
    components: np.ndarray  # K T 2
    weights: np.ndarray  # K
    goal: np.ndarray  # 2
    candidates: np.ndarray  # C T 2
    neighbors: np.ndarray  # N T 2, NaN where unknown


def draw_scene(axes: Axes, scene: PlannedScene) -> None:
    """Draw one sample into a pair of axes."""
    for path in scene.candidates:
        axes.plot(*path.T, color="0.85", linewidth=0.6, label="candidates", zorder=1)
    heaviest = scene.weights.max(initial=0.0)
    for path, weight in zip(scene.components, scene.weights, strict=True):
        axes.plot(
            *path.T,
            color=PALETTE[5],
            linewidth=1.4,
            alpha=max(FAINTEST, float(weight / heaviest)) if heaviest > 0 else FAINTEST,
            label="components of the forecast",
            zorder=2,
        )
    for path in scene.neighbors:
        axes.plot(
            *path.T, color=PALETTE[3], linewidth=1.0, label="others, from the square", zorder=2
        )
        axes.plot(*path[0], "s", color=PALETTE[3], markersize=3)
    axes.plot(*scene.past.T, color="0.4", linewidth=1.2, label="past", zorder=3)
    axes.plot(*scene.human.T, color=PALETTE[6], linewidth=2.2, label="human", zorder=4)
    axes.plot(*scene.plan.T, color=PALETTE[1], linewidth=2.4, label="plan", zorder=5)
    # dashed on top: the plan mostly follows it and would hide it
    axes.plot(
        *scene.prediction.T, "--", color=PALETTE[0], linewidth=1.2, label="prediction", zorder=6
    )
    axes.plot(*scene.goal, "*", color=PALETTE[2], markersize=10, label="goal", zorder=7)
    axes.set_title(scene.title, fontsize=8)
    axes.set_aspect("equal", "box")
    _frame(axes, scene)
    axes.grid(alpha=0.3)
    axes.tick_params(labelsize=7)


def _frame(axes: Axes, scene: PlannedScene) -> None:
    """Show all of past, human, plan and goal, in one shape for all scenes."""
    seen = np.concatenate([scene.past, scene.human, scene.plan, scene.goal[None]])
    seen = seen[np.isfinite(seen).all(-1)]
    centre = 0.5 * (seen.min(0) + seen.max(0))
    wide, high = 0.5 * np.ptp(seen, axis=0) + MARGIN_M
    half = max(wide, high / ASPECT)
    axes.set_xlim(centre[0] - half, centre[0] + half)
    axes.set_ylim(centre[1] - ASPECT * half, centre[1] + ASPECT * half)


def _legend(figure: Figure) -> None:
    """One entry per kind of line, for all panels, where no line runs."""
    named: dict[str, Artist] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    where = "outside upper center"
    legend = figure.legend(named.values(), named.keys(), fontsize=7, ncols=4, loc=where)
    for line in legend.get_lines():
        line.set_alpha(1.0)  # a component of little weight is drawn too faint to be recognised


def draw_scenes(scenes: Sequence[PlannedScene], columns: int = 3) -> Figure:
    """Draw samples in a grid, x and y in m, with one legend."""
    rows = -(-len(scenes) // columns)
    figure = new_figure(4.0 * columns, 3.4 * rows)
    for index, scene in enumerate(scenes):
        draw_scene(figure.add_subplot(rows, columns, index + 1), scene)
    _legend(figure)
    figure.supxlabel("x [m]", fontsize=8)
    figure.supylabel("y [m]", fontsize=8)
    return figure
