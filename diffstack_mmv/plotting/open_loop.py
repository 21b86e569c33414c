"""Figures of open-loop runs: paths, speeds, lean, tyre forces against friction, loads."""

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from torch import Tensor

from diffstack_mmv.plotting.figures import PALETTE, new_figure
from diffstack_mmv.types import Motion


@runtime_checkable
class WheelHistory(Protocol):
    """What happened at the wheels, in N."""

    @property
    def force_x(self) -> Float[Tensor, "T wheels"]:
        """Forward in the wheels' axes."""
        ...

    @property
    def force_y(self) -> Float[Tensor, "T wheels"]:
        """To the left."""
        ...

    @property
    def normal_load(self) -> Float[Tensor, "T wheels"]:
        """Loads."""
        ...

    @property
    def friction_limit(self) -> Float[Tensor, "T wheels"]:
        """Largest force that friction allows."""
        ...


def draw_runs(motions: Mapping[str, Motion], dt_s: float, lean: np.ndarray | None) -> Figure:
    """Draw path, speed, yaw rate and lean of several models under the same commands.

    Args:
        motions: By model, over time: position of shape (T, 2) in m, velocity in m/s.
        dt_s: Length of a step in s.
        lean: Lean in rad, of shape (T,); none where the vehicle does not lean, or its model does
            not.
    """
    figure = new_figure(9.0, 6.4)
    path, speed, yaw, roll = (figure.add_subplot(2, 2, index) for index in range(1, 5))
    for index, (name, motion) in enumerate(motions.items()):
        colour, width = PALETTE[index % len(PALETTE)], max(2.2 - 0.5 * index, 0.7)
        style = {"color": colour, "linewidth": width, "label": name}
        position = motion.position.numpy()
        time_s = dt_s * np.arange(len(position))
        path.plot(position[:, 0], position[:, 1], **style)
        speed.plot(time_s, motion.velocity.norm(dim=-1).numpy(), **style)
        yaw.plot(time_s, motion.yaw_rate.numpy(), **style)
    path.set(xlabel="x [m]", ylabel="y [m]", title="path of the centre of gravity")
    path.set_aspect("equal", adjustable="datalim")
    path.legend(fontsize=8)
    speed.set(xlabel="time [s]", ylabel="speed [m/s]")
    yaw.set(xlabel="time [s]", ylabel="yaw rate [rad/s]")
    roll.set(xlabel="time [s]", ylabel="lean to the left [rad]")
    if lean is None:
        roll.text(
            0.5, 0.5, "the model has no lean", ha="center", va="center", transform=roll.transAxes
        )
    else:
        roll.plot(dt_s * np.arange(len(lean)), lean, color=PALETTE[0])
    for axes in (path, speed, yaw, roll):
        axes.grid(alpha=0.3)
    return figure


def draw_wheels(wheels: WheelHistory, names: Sequence[str], dt_s: float) -> Figure:
    """Draw tyre forces as shares of the friction limit, and the loads of all named wheels."""
    figure = new_figure(9.0, 4.2)
    circle, load = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    circle.add_patch(Circle((0, 0), 1, fill=False, linestyle="--"))
    time_s = dt_s * np.arange(len(wheels.normal_load))
    for index, name in enumerate(names):
        colour = PALETTE[index % len(PALETTE)]
        _draw_shares(circle, wheels, index, colour)
        load.plot(
            time_s, wheels.normal_load[:, index].numpy(), color=colour, label=name.replace("_", " ")
        )
    circle.set(
        xlabel="to the left  F_y / (μ F_z)",
        ylabel="forward  F_x / (μ F_z)",
        title="tyre forces in the friction circle",
        xlim=(1.15, -1.15),
        ylim=(-1.15, 1.15),
        aspect="equal",
    )
    load.set(xlabel="time [s]", ylabel="normal load [N]", title="loads")
    load.set_ylim(0, 1.25 * float(wheels.normal_load.max()))  # with room for the legend
    load.legend(fontsize=8, loc="upper center", ncols=3)
    for axes in (circle, load):
        axes.grid(alpha=0.3)
    return figure


def _draw_shares(axes: Axes, wheels: WheelHistory, index: int, colour: str) -> None:
    limit = wheels.friction_limit[:, index].clamp_min(1e-6)
    axes.plot(
        (wheels.force_y[:, index] / limit).numpy(),
        (wheels.force_x[:, index] / limit).numpy(),
        ".-",
        color=colour,
        markersize=3,
        linewidth=0.7,
    )
