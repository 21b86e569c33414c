"""One closed-loop episode, and how it is drawn into a picture."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon
from torch import Tensor

from diffstack_mmv.geometry import position_from_frame
from diffstack_mmv.plotting.figures import PALETTE, new_figure
from diffstack_mmv.types import EpisodeRecord, Outcome, map_tensors

ROBOT, PEDESTRIANS, NOSE = PALETTE[1], PALETTE[0], "black"
GOAL_MARK = {"color": PALETTE[2], "marker": "*", "markersize": 12, "linestyle": "none"}
MARGIN_M = 1.0
ROBOT_RADIUS_M = 0.3
THOUGHTS = {
    "candidates": {"color": "0.75", "linewidth": 0.6, "zorder": 1},
    "forecast": {"color": PEDESTRIANS, "linewidth": 1.0, "linestyle": ":"},
    "plan": {"color": ROBOT, "linewidth": 1.6, "linestyle": "--"},
}
"""How the lines look that a controller tells of."""


class CaseStart(NamedTuple):
    """What a case begins with and its record does not tell."""

    radii_m: Sequence[float]  # of the pedestrians
    goal_m: Sequence[float] | None = None  # x and y of the goal of the robot


class Episode(NamedTuple):
    """One case of a benchmark."""

    case: int
    record: EpisodeRecord  # without leading dimensions
    start: CaseStart
    outline: Float[Tensor, "corners 2"] | None = None  # m, of the robot; a disc of 0.3 m if None
    thoughts: Mapping[str, Any] = {}  # per decision: candidates, plan, forecast in m
    control_names: tuple[str, ...] = ()  # as in the `Control` of the robot's model


def episode_of(
    record: EpisodeRecord,
    row: int,
    case: int,
    start: CaseStart,
    outline: Float[Tensor, "corners 2"] | None = None,
) -> Episode:
    """One episode of a batch, cut at its end; the outline of the robot in m."""
    single = map_tensors(lambda field: field[row], record)
    end = int(single.steps) + 1
    motion = type(single.motion)(*(field[:end] for field in single.motion))
    cut = single._replace(
        motion=motion, pedestrians=single.pedestrians[:end], clearance=single.clearance[:end]
    )
    return Episode(case, cut, start, outline)


def told(episode: Episode) -> str:
    """How it ended."""
    record = episode.record
    return f"{Outcome(int(record.outcome)).label} after {float(record.duration):.2f} s"


def draw_episode(episode: Episode) -> Figure:
    """Paths of robot and pedestrians with outlines once per second, darkest at the end."""
    figure = new_figure(5.0, 5.0)
    axes = figure.add_subplot()
    draw_paths(axes, episode)
    axes.set_title(f"case {episode.case}: {told(episode)}")
    explain_paths(figure, [episode])
    return figure


def draw_paths(axes: Axes, episode: Episode) -> None:
    """The picture of `draw_episode` without a title and a legend."""
    set_range(axes, episode)
    record = episode.record
    axes.plot(*record.motion.position.T.numpy(), color=ROBOT)
    for pedestrian in record.pedestrians.unbind(1):
        axes.plot(*pedestrian.T.numpy(), color=PEDESTRIANS, linewidth=0.8)
    last = len(record.clearance) - 1
    for step in range(0, last, max(round(1 / record.dt_s), 1)):
        draw_outlines(axes, episode, step, 0.15 + 0.4 * step / last)
    draw_outlines(axes, episode, last, 0.8)


def draw_thoughts(axes: Axes, thoughts: Mapping[str, Any], step: int) -> list[Line2D]:
    """Lines of candidates, forecasts and plan at a decision."""
    lines = []
    for name, style in THOUGHTS.items():
        if step < len(thoughts.get(name, ())):
            told = thoughts[name][step]
            for path in told.reshape(-1, *told.shape[-2:]):
                lines += axes.plot(path[:, 0], path[:, 1], **style)
    return lines


def explain_paths(figure: Figure, episodes: Sequence[Episode]) -> None:
    """Say below pictures of paths what is drawn."""
    still = [episode._replace(thoughts={}) for episode in episodes]
    explain(figure, legend_of(still, "robot, each second"))


def explain(figure: Figure, handles: Sequence[Line2D | Patch]) -> None:
    """Put a legend below the pictures of a figure."""
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize="small")


def legend_of(episodes: Sequence[Episode], robot: str = "robot") -> list[Line2D | Patch]:
    """What a legend below pictures explains.

    Args:
        episodes: All that are shown.
        robot: What to call the robot.

    Returns:
        Handles of whatever is drawn of everybody, and of the lines that some controller tells of.
    """
    known = {name for episode in episodes for name in episode.thoughts}
    lines = [Line2D([], [], label=name, **THOUGHTS[name]) for name in THOUGHTS if name in known]
    with_goal = any(episode.start.goal_m is not None for episode in episodes)
    goal = [Line2D([], [], label="goal", **GOAL_MARK)] if with_goal else []
    nose = Line2D([], [], label="heading", color=NOSE, marker=".", linestyle="none")
    who = [Patch(color=ROBOT, label=robot), nose, Patch(color=PEDESTRIANS, label="pedestrians")]
    return [*who, *goal, *lines]


def set_range(axes: Axes, episode: Episode) -> None:
    """Axes in m that hold everybody."""
    everybody = episode.record.pedestrians.nan_to_num(), episode.record.motion.position
    reach = max(float(places.abs().max()) for places in everybody if places.numel() > 0)
    goal_m = episode.start.goal_m
    if goal_m is not None:
        reach = max(reach, *(abs(entry) for entry in goal_m))
    reach += MARGIN_M
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    if goal_m is not None:
        axes.plot(*goal_m, **GOAL_MARK)


def draw_outlines(axes: Axes, episode: Episode, step: int, alpha: float) -> None:
    """Outlines of everybody at one step."""
    pedestrians = episode.record.pedestrians[step]
    for place, radius_m in zip(pedestrians, episode.start.radii_m, strict=True):
        if place.isfinite().all():
            centre = tuple(place.tolist())
            axes.add_patch(Circle(centre, radius_m, color=PEDESTRIANS, alpha=alpha))
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
    axes.add_patch(Circle(tuple(tip), 0.06, color=NOSE, alpha=alpha))
