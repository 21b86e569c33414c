"""Checks of what a configuration says of an evaluation; nothing heavy is needed.

As in `config_checks`, a mistake is told before what takes seconds is imported.
"""

from omegaconf import DictConfig

from diffstack_mmv.commands.config_checks import require_checkpoint
from diffstack_mmv.commands.data_checks import (
    require_data,
    require_recordings,
    require_situations,
    require_split,
    require_windows,
)
from dmmv_conventions.checks import require


def require_evaluation(config: DictConfig) -> None:
    """Refuse an evaluation without checkpoint or recordings, or of splits that are none.

    Args:
        config: Configuration of the command `evaluate`.

    Raises:
        ValueError: A file is not there, a name is unknown, a number is out of its range, or the
            levels would be fitted to what they are judged on.
    """
    require_checkpoint("checkpoint", config.checkpoint)
    for place, path in enumerate(config.ensemble):
        require_checkpoint(f"ensemble[{place}]", path)
    require_windows(
        config.modes or [], config.dt_s, history_s=config.history_s, horizon_s=config.horizon_s
    )
    require_data(config.data.module.windows, config.batch_size)
    exported = config.data.module.get("export") is not None
    remedy = "Leave it out: an evaluation is told by situations, which stand in the export."
    require(exported, "data.module.export", "say where windows are kept", None, "", remedy)
    require_recordings(config.data.module.source)
    require_split("split", config.split, config.data.module.source)
    fitted_on = config.calibration.split
    if fitted_on is not None:
        require_split("calibration.split", fitted_on, config.data.module.source)
        apart = config.split not in (fitted_on, "all")
        remedy = "Regions that were corrected on what they are judged on hold what they should."
        require(apart, "calibration.split", "be no part of `split`", fitted_on, "", remedy)
    require_situations(config.situations)
