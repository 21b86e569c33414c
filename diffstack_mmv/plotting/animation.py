"""Episodes as moving pictures: GIF, or MP4 with the extra `video`."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from matplotlib import rc_context
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from diffstack_mmv.plotting.episodes import (
    PEDESTRIANS,
    ROBOT,
    Episode,
    draw_outlines,
    draw_paths,
    draw_thoughts,
    explain,
    explain_paths,
    legend_of,
    set_range,
    told,
)
from diffstack_mmv.plotting.figures import PALETTE, control_title, new_figure
from diffstack_mmv.types import EpisodeRecord
from dmmv_conventions.disk import UNFINISHED, replacing
from dmmv_conventions.extras import needs


def save_animation(episode: Episode, path: Path) -> None:
    """Write an episode in real time, atomically, as the ending of the path says.

    Beside the picture run clearance and controls; where the controller tells of them, its
    candidates, forecasts and plan are drawn at every decision.

    Args:
        episode: The episode.
        path: A .gif, or a .mp4, which needs the extra `video`.

    Raises:
        ValueError: The path ends otherwise.
    """
    figure = new_figure(8.5, 4.8)
    places = figure.add_gridspec(2, 2, width_ratios=(1.4, 1.0))
    axes, above = figure.add_subplot(places[:, 0]), figure.add_subplot(places[0, 1])
    below = figure.add_subplot(places[1, 1], sharex=above)
    record = episode.record
    cursors = draw_curves(above, below, episode)
    explain(figure, legend_of([episode]))
    show = _frame(axes, episode, "")

    def step(number: int) -> list[Any]:
        for cursor in cursors:
            cursor.set_xdata([number * record.dt_s] * 2)
        return show(number)

    _write(figure, step, len(record.clearance), record.dt_s, path)


def draw_side_by_side(names: Sequence[str], episodes: Sequence[Episode]) -> Figure:
    """Several controllers in the same case: their paths in a row, each under its name."""
    figure = new_figure(4.6 * len(episodes), 5.0)
    for number, (name, episode) in enumerate(zip(names, episodes, strict=True)):
        axes = figure.add_subplot(1, len(episodes), number + 1)
        draw_paths(axes, episode)
        axes.set_title(f"{name}: {told(episode)}")
    explain_paths(figure, episodes)
    return figure


def save_side_by_side(names: Sequence[str], episodes: Sequence[Episode], path: Path) -> None:
    """Write several controllers in the same case as one moving picture, clearance below.

    Who has ended stays where it was until all have.

    Args:
        names: What to call the controllers.
        episodes: One per controller.
        path: A .gif, or a .mp4, which needs the extra `video`.

    Raises:
        ValueError: The path ends otherwise.
    """
    figure = new_figure(4.6 * len(episodes), 6.5)
    places = figure.add_gridspec(2, len(episodes), height_ratios=(3.2, 1.0))
    dt_s, shows, cursors, below = episodes[0].record.dt_s, [], [], None
    ends = [len(episode.record.clearance) - 1 for episode in episodes]
    frames = max(ends) + 1
    explain(figure, legend_of(episodes))
    for column, (name, episode) in enumerate(zip(names, episodes, strict=True)):
        shows.append(_frame(figure.add_subplot(places[0, column]), episode, f"{name}\n"))
        below = figure.add_subplot(places[1, column], sharex=below, sharey=below)
        cursors.append(_clearance(below, episode.record))
        below.set_xlim(0, max(ends) * dt_s)
        below.set_xlabel("time [s]")

    def step(number: int) -> list[Any]:
        for cursor, end in zip(cursors, ends, strict=True):
            cursor.set_xdata([min(number, end) * dt_s] * 2)
        return [artist for show in shows for artist in show(number)]

    _write(figure, step, frames, dt_s, path)


def _frame(axes: Axes, episode: Episode, heading: str) -> Callable[[int], list[Any]]:
    """What draws an episode at a step, over whatever was drawn before."""
    set_range(axes, episode)
    record, thinking = episode.record, []

    def show(number: int) -> list[Any]:
        for artist in [*axes.patches, *thinking]:
            artist.remove()
        step = min(number, len(record.clearance) - 1)
        thinking[:] = draw_thoughts(axes, episode.thoughts, step)
        draw_outlines(axes, episode, step, 0.8)
        clearance = float(record.clearance[step])
        ended = step < number or step == len(record.clearance) - 1
        now = told(episode) if ended else f"{step * record.dt_s:.2f} s, {clearance:.2f} m clear"
        axes.set_title(heading + now)
        return list(axes.patches)

    return show


def _write(
    figure: Figure, step: Callable[[int], list[Any]], frames: int, dt_s: float, path: Path
) -> None:
    """Write a moving picture in real time, atomically."""
    save = FORMATS.get(path.suffix)
    if save is None:
        wanted = " or ".join(FORMATS)
        raise ValueError(f"`path` must end in {wanted}, but got {path.name}. Choose a format.")
    animation = FuncAnimation(figure, step, frames=frames)
    with replacing(path, f"{UNFINISHED}{path.suffix}") as unfinished:
        save(animation, unfinished, round(1 / dt_s))


def _save_gif(animation: FuncAnimation, path: Path, fps: int) -> None:
    _save(animation, path, PillowWriter(fps=fps))


def _save_mp4(animation: FuncAnimation, path: Path, fps: int) -> None:
    with needs("video", "moving pictures as MP4"):
        from imageio_ffmpeg import get_ffmpeg_exe  # pyright: ignore[reportMissingImports]
    with rc_context({"animation.ffmpeg_path": get_ffmpeg_exe()}):
        # players want even sizes and colours at half resolution
        even = ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white", "-pix_fmt", "yuv420p"]
        _save(animation, path, FFMpegWriter(fps=fps, codec="libx264", extra_args=even))


FORMATS: dict[str, Callable[[FuncAnimation, Path, int], None]] = {
    ".gif": _save_gif,
    ".mp4": _save_mp4,
}
"""How a moving picture of so many frames a second is written, by the ending of its file."""


def _save(animation: FuncAnimation, path: Path, writer: AbstractMovieWriter) -> None:
    animation.save(path, writer=writer, dpi=90)


def draw_curves(above: Axes, below: Axes, episode: Episode) -> list[Line2D]:
    """Draw clearance and controls over time.

    Args:
        above: Receives the clearance.
        below: Receives the controls.
        episode: The episode.

    Returns:
        The cursors in both pictures.
    """
    record, names = episode.record, episode.control_names
    values = record.controls[: len(record.clearance) - 1]
    time = record.dt_s * torch.arange(len(values) + 1)
    for column, held in enumerate(values.unbind(-1)):
        label = control_title(names[column]) if names else f"control {column + 1}"
        below.stairs(held, time, baseline=None, color=PALETTE[column], label=label)
    # above it: between the two pictures no curve is hidden
    place = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "ncols": values.shape[-1]}
    below.legend(fontsize="small", frameon=False, **place)
    below.set_xlabel("time [s]")
    return [_clearance(above, record), below.axvline(0.0, color=ROBOT)]


def _clearance(axes: Axes, record: EpisodeRecord) -> Line2D:
    """Clearance over time; the cursor."""
    axes.plot(
        record.dt_s * torch.arange(len(record.clearance)), record.clearance, color=PEDESTRIANS
    )
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.set_ylabel("clearance [m]")
    return axes.axvline(0.0, color=ROBOT)
