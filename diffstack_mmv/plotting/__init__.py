"""Figures of plans, errors and runs."""

from diffstack_mmv.plotting.closed_loop import (
    Episode,
    draw_episode,
    episode_of,
    save_animation,
    save_stories,
)
from diffstack_mmv.plotting.figures import save_figure
from diffstack_mmv.plotting.horizon import draw_error_over_horizon
from diffstack_mmv.plotting.open_loop import draw_runs, draw_wheels
from diffstack_mmv.plotting.plans import Scene, draw_scene, draw_scenes

__all__ = [
    "Episode",
    "Scene",
    "draw_episode",
    "draw_error_over_horizon",
    "draw_runs",
    "draw_scene",
    "draw_scenes",
    "draw_wheels",
    "episode_of",
    "save_animation",
    "save_figure",
    "save_stories",
]
