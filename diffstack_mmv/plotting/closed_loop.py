"""Pictures and animations of closed-loop episodes."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon
from torch import Tensor

from diffstack_mmv.geometry import position_from_frame
from diffstack_mmv.plotting.figures import PALETTE, new_figure, save_figure
from diffstack_mmv.types import EpisodeRecord, Outcome, map_tensors

ROBOT, PEDESTRIANS, GOAL = PALETTE[1], PALETTE[0], PALETTE[2]
MARGIN_M = 1.0
ROBOT_RADIUS_M = 0.3


class Episode(NamedTuple):
    """One case of a benchmark."""

    case: int
    record: EpisodeRecord  # without leading dimensions
    pedestrian_radius_m: float
    goal_m: tuple[float, float] | None = None  # of the robot
    outline: Float[Tensor, "corners 2"] | None = None  # m, of the robot; a disc of 0.3 m if None
    thoughts: Mapping[str, Any] = {}  # per decision: candidates, plan, forecast in m


def episode_of(
    record: EpisodeRecord,
    row: int,
    case: int,
    pedestrian_radius_m: float,
    goal_m: tuple[float, float] | None = None,
    outline: Float[Tensor, "corners 2"] | None = None,
) -> Episode:
    """One episode of a batch, cut at its end; radius of the pedestrians, goal and outline in m."""
    single = map_tensors(lambda field: field[row], record)
    end = int(single.steps) + 1
    motion = type(single.motion)(*(field[:end] for field in single.motion))
    cut = single._replace(
        motion=motion, pedestrians=single.pedestrians[:end], clearance=single.clearance[:end]
    )
    return Episode(case, cut, pedestrian_radius_m, goal_m, outline)


def draw_episode(episode: Episode) -> Figure:
    """Paths of robot and pedestrians with outlines once per second, darkest at the end."""
    figure = new_figure(5.0, 5.0)
    axes = _axes(figure, episode)
    record = episode.record
    axes.plot(*record.motion.position.T.numpy(), color=ROBOT)
    for pedestrian in record.pedestrians.unbind(1):
        axes.plot(*pedestrian.T.numpy(), color=PEDESTRIANS, linewidth=0.8)
    last = len(record.clearance) - 1
    for step in range(0, last, max(round(1 / record.dt_s), 1)):
        _outlines(axes, episode, step, 0.15 + 0.4 * step / last)
    _outlines(axes, episode, last, 0.8)
    handles = [
        Patch(color=ROBOT, label="robot, each second"),
        Patch(color=PEDESTRIANS, label="pedestrians"),
        Patch(color=GOAL, label="goal"),
    ]
    axes.legend(handles=handles, loc="lower right", fontsize="small")
    outcome = Outcome(int(record.outcome)).label
    axes.set_title(f"case {episode.case}: {outcome} after {float(record.duration):.2f} s")
    return figure


def save_animation(episode: Episode, path: Path) -> None:
    """Write an animated GIF of an episode in real time, atomically.

    Beside the picture run clearance and controls; where the controller tells of them, its
    candidates, forecasts and plan are drawn at every decision.
    """
    figure = new_figure(8.5, 4.5)
    places = figure.add_gridspec(2, 2, width_ratios=(1.4, 1.0))
    axes = _axes(figure, episode, figure.add_subplot(places[:, 0]))
    record = episode.record
    cursors = _curves(figure.add_subplot(places[0, 1]), figure.add_subplot(places[1, 1]), record)
    thinking: list[Any] = []

    def show(step: int) -> list[Any]:
        for artist in [*axes.patches, *thinking]:
            artist.remove()
        thinking[:] = _thinking(axes, episode.thoughts, step)
        _outlines(axes, episode, step, 0.8)
        clearance = float(record.clearance[step])
        axes.set_title(f"{step * record.dt_s:.2f} s, clearance {clearance:.2f} m")
        for cursor in cursors:
            cursor.set_xdata([step * record.dt_s] * 2)
        return list(axes.patches)

    animation = FuncAnimation(figure, show, frames=len(record.clearance))
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(path.stem + ".part" + path.suffix)
    animation.save(unfinished, writer=PillowWriter(fps=round(1 / record.dt_s)), dpi=90)
    unfinished.replace(path)


def _curves(above: Axes, below: Axes, record: EpisodeRecord) -> list[Line2D]:
    """Clearance and controls over time; the cursors in both pictures."""
    time = record.dt_s * torch.arange(len(record.clearance))
    above.plot(time, record.clearance, color=PEDESTRIANS)
    above.axhline(0.0, color="black", linewidth=0.8)
    above.set_ylabel("clearance [m]")
    for column, values in enumerate(record.controls[: len(time) - 1].unbind(-1)):
        label = f"control {column + 1}"
        below.step(time[: len(values)], values, where="post", color=PALETTE[column], label=label)
    below.legend(fontsize="small")
    below.set_xlabel("time [s]")
    return [each.axvline(0.0, color=ROBOT) for each in (above, below)]


def _thinking(axes: Axes, thoughts: Mapping[str, Any], step: int) -> list[Line2D]:
    """Lines of candidates, forecasts and plan at a decision."""
    styles = {
        "candidates": {"color": "0.75", "linewidth": 0.6, "zorder": 1},
        "forecast": {"color": PEDESTRIANS, "linewidth": 1.0, "linestyle": ":"},
        "plan": {"color": ROBOT, "linewidth": 1.6, "linestyle": "--"},
    }
    lines = []
    for name, style in styles.items():
        if step < len(thoughts.get(name, ())):
            told = thoughts[name][step]
            for path in told.reshape(-1, *told.shape[-2:]):
                lines += axes.plot(path[:, 0], path[:, 1], **style)
    return lines


def save_stories(
    folder: Path,
    cases: Sequence[int],
    records: Sequence[EpisodeRecord],
    radius_m: float,
    count: int,
    goal_m: tuple[float, float] | None = None,
    chosen: Sequence[int] = (),
    outline: Float[Tensor, "corners 2"] | None = None,
    thoughts_of: Callable[[int], Mapping[str, Any]] | None = None,
) -> None:
    """Draw and animate some episodes: those asked for, then failures, then the others.

    Args:
        folder: Receives plots/case_N.png and plots/case_N.gif.
        cases: Numbers of the cases in the order of the records.
        records: Records, one after the other.
        radius_m: Radius of the pedestrians.
        count: Number of episodes to show besides those asked for.
        goal_m: Goal of the robot in m.
        chosen: Cases asked for.
        outline: Polygon of the robot around its reference point in m; a disc of 0.3 m if None.
        thoughts_of: Number of a case -> what the controller expected and planned in it.

    Raises:
        ValueError: A case asked for is none of these.
    """
    unknown = sorted(set(chosen) - set(cases))
    if unknown:
        told = f"{cases[0]} to {cases[-1]}"
        raise ValueError(f"`chosen` must name cases among {told}, but got {unknown}. Drive them.")
    places = [(record, row) for record in records for row in range(len(record.outcome))]
    outcomes = [int(record.outcome[row]) for record, row in places]
    asked = [index for index, case in enumerate(cases) if case in chosen]
    rest = [index for index in range(len(cases)) if index not in asked]
    rest.sort(key=lambda index: outcomes[index] == Outcome.SUCCESS)
    for index in [*asked, *rest[:count]]:
        record, row = places[index]
        episode = episode_of(record, row, cases[index], radius_m, goal_m, outline)
        if thoughts_of is not None:
            episode = episode._replace(thoughts=thoughts_of(episode.case))
        save_figure(draw_episode(episode), folder / "plots" / f"case_{episode.case}.png")
        save_animation(episode, folder / "plots" / f"case_{episode.case}.gif")


def _axes(figure: Figure, episode: Episode, given: Axes | None = None) -> Axes:
    """Axes in m that hold everybody."""
    axes = figure.add_subplot() if given is None else given
    reach = float(episode.record.pedestrians.nan_to_num().abs().max())
    reach = max(reach, float(episode.record.motion.position.abs().max()))
    if episode.goal_m is not None:
        reach = max(reach, *(abs(entry) for entry in episode.goal_m))
    reach += MARGIN_M
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    if episode.goal_m is not None:
        axes.plot(*episode.goal_m, marker="*", markersize=12, color=GOAL, linestyle="none")
    return axes


def _outlines(axes: Axes, episode: Episode, step: int, alpha: float) -> None:
    """Outlines of everybody at one step."""
    pedestrians = episode.record.pedestrians[step]
    for place in pedestrians[pedestrians.isfinite().all(-1)].tolist():
        axes.add_patch(
            Circle(tuple(place), episode.pedestrian_radius_m, color=PEDESTRIANS, alpha=alpha)
        )
    motion = episode.record.motion
    centre = motion.position[step].tolist()
    if episode.outline is None:
        axes.add_patch(Circle(tuple(centre), ROBOT_RADIUS_M, color=ROBOT, alpha=alpha))
    else:
        place = (motion.position[step], motion.heading[step])
        corners = position_from_frame(episode.outline.to(place[0]), *place)
        axes.add_patch(Polygon(corners.numpy(), color=ROBOT, alpha=alpha))
    nose = motion.heading[step]
    tip = [centre[0] + float(nose.cos()) * 0.3, centre[1] + float(nose.sin()) * 0.3]
    axes.add_patch(Circle(tuple(tip), 0.06, color="black", alpha=alpha))
