"""Scores of predictions, plans and closed-loop episodes, each computed in one place only."""

from typing import TYPE_CHECKING

from dmmv_conventions.on_demand import on_demand

if TYPE_CHECKING:
    from diffstack_mmv.metrics.by_mode import MeanByMode
    from diffstack_mmv.metrics.calibration import (
        Calibration,
        DensityLevels,
        coverages,
        judged_levels,
    )
    from diffstack_mmv.metrics.displacement import (
        average_displacement,
        best_average_displacement,
        displacement_curve,
        displacements,
        final_displacement,
        mean_square_displacement,
        missed,
    )
    from diffstack_mmv.metrics.excited import EXCITATION, LATERAL, SPEED, Excited, excitation
    from diffstack_mmv.metrics.likelihood import negative_log_likelihood
    from diffstack_mmv.metrics.means import masked_mean, time_mean, where_known
    from diffstack_mmv.metrics.planning import (
        collided,
        human_collided,
        planning_loss,
        solved,
        total_cost,
    )
    from diffstack_mmv.metrics.sampling import (
        best_of_samples,
        energy_score,
        sampled_paths,
        spread_paths,
    )
    from diffstack_mmv.metrics.scores import (
        CALIBRATION,
        CLOSED_LOOP,
        DISPLACEMENT,
        EVALUATED,
        OF_THE_PREDICTION,
        OPEN_LOOP,
        PREDICTED,
        Score,
    )

__getattr__ = on_demand(__name__, __file__, "stack")
__all__ = [
    "CALIBRATION",
    "CLOSED_LOOP",
    "DISPLACEMENT",
    "EVALUATED",
    "EXCITATION",
    "LATERAL",
    "OF_THE_PREDICTION",
    "OPEN_LOOP",
    "PREDICTED",
    "SPEED",
    "Calibration",
    "DensityLevels",
    "Excited",
    "MeanByMode",
    "Score",
    "average_displacement",
    "best_average_displacement",
    "best_of_samples",
    "energy_score",
    "collided",
    "coverages",
    "displacement_curve",
    "displacements",
    "excitation",
    "final_displacement",
    "human_collided",
    "judged_levels",
    "masked_mean",
    "mean_square_displacement",
    "missed",
    "negative_log_likelihood",
    "planning_loss",
    "sampled_paths",
    "spread_paths",
    "solved",
    "time_mean",
    "total_cost",
    "where_known",
]
