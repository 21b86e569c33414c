"""Figures of plans, errors and runs."""

from dmmv_conventions.extras import needs

with needs("stack", "diffstack_mmv.plotting"):
    from diffstack_mmv.plotting.animation import (
        draw_side_by_side,
        save_animation,
        save_side_by_side,
    )
    from diffstack_mmv.plotting.closed_loop import save_story, worth_showing
    from diffstack_mmv.plotting.episodes import CaseStart, Episode, draw_episode, episode_of
    from diffstack_mmv.plotting.estimates import (
        Estimate,
        draw_estimates,
        draw_profiles,
        draw_spectrum,
    )
    from diffstack_mmv.plotting.evaluation import PLANS_FILE, remove_evaluation, save_evaluation
    from diffstack_mmv.plotting.excitation import draw_by_excitation, save_by_excitation
    from diffstack_mmv.plotting.figures import save_figure
    from diffstack_mmv.plotting.horizon import draw_error_over_horizon
    from diffstack_mmv.plotting.identification import (
        FittedTrack,
        draw_controls,
        draw_lean,
        draw_tracks,
        save_identification,
    )
    from diffstack_mmv.plotting.open_loop import draw_runs, draw_wheels
    from diffstack_mmv.plotting.plans import PlannedScene, draw_scene, draw_scenes
    from diffstack_mmv.plotting.reliability import draw_reliability

__all__ = [
    "CaseStart",
    "Episode",
    "Estimate",
    "FittedTrack",
    "PLANS_FILE",
    "PlannedScene",
    "draw_by_excitation",
    "draw_controls",
    "draw_episode",
    "draw_error_over_horizon",
    "draw_estimates",
    "draw_lean",
    "draw_profiles",
    "draw_reliability",
    "draw_runs",
    "draw_scene",
    "draw_scenes",
    "draw_spectrum",
    "draw_side_by_side",
    "draw_tracks",
    "draw_wheels",
    "episode_of",
    "remove_evaluation",
    "save_animation",
    "save_by_excitation",
    "save_evaluation",
    "save_figure",
    "save_identification",
    "save_side_by_side",
    "save_story",
    "worth_showing",
]
