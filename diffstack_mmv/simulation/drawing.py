"""Pictures of a world for `render`; matplotlib is loaded with this module only."""

import numpy as np

from diffstack_mmv.geometry import position_from_frame
from diffstack_mmv.simulation.world import World, WorldState
from dmmv_conventions.extras import needs

with needs("stack", "pictures of the environment"):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Polygon

ROBOT, HUMAN, GOAL = "tab:orange", "tab:blue", "tab:red"
MARGIN_M = 2.0


def picture(world: World, state: WorldState) -> np.ndarray:
    """Robot, pedestrians and goals from above.

    Args:
        world: The world.
        state: State of one episode, without leading dimensions, m.

    Returns:
        Pixels, (480, 480, 3) uint8.
    """
    figure = Figure(figsize=(4.8, 4.8), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.08, 0.06, 0.88, 0.88))
    motion = world.robot.motion(state.robot)
    place = motion.position.detach().numpy()
    heading = float(motion.heading)
    radius = world.robot.footprint.radius_m
    for position, size in zip(
        state.pedestrians.position.numpy(), state.pedestrians.radius.numpy(), strict=True
    ):
        axes.add_patch(Circle(tuple(position), float(size), color=HUMAN, alpha=0.7))
    outline = position_from_frame(world.robot.footprint.outline(), motion.position, motion.heading)
    axes.add_patch(Polygon(outline.detach().numpy(), color=ROBOT))
    nose = place + radius * np.array((np.cos(heading), np.sin(heading)))
    axes.plot(*zip(place, nose, strict=True), color="black")
    axes.plot(*state.goal.numpy(), marker="*", markersize=12, color=GOAL)
    reach = float(state.goal.abs().max()) + MARGIN_M
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")
    axes.set_title(f"{float(state.time):.2f} s")
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
