"""Figures of plans, errors and runs."""

from diffstack_mmv.plotting.figures import save_figure
from diffstack_mmv.plotting.horizon import draw_error_over_horizon
from diffstack_mmv.plotting.plans import Scene, draw_scene, draw_scenes

__all__ = ["Scene", "draw_error_over_horizon", "draw_scene", "draw_scenes", "save_figure"]
