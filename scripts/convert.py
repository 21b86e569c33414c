"""Convert recordings to a trajdata cache."""

import logging
from pathlib import Path

from diffstack_mmv.commands.cli import DictConfig, command, instantiate
from diffstack_mmv.commands.config_checks import require_folder
from dmmv_conventions.cache import REPORT_FILE
from dmmv_conventions.checks import require
from dmmv_conventions.configs import config_folder

logger = logging.getLogger(__name__)


def check(config: DictConfig) -> None:
    """Refuse a data set without converter, and a folder that is not there."""
    named = "recordings" in config.data
    require(named, "data", "be a data set that has a converter", config.data.name)
    require(bool(config.data.root), "data.root", "be given", None, "", "Add data.root=RECORDINGS.")
    require_folder("data.root", config.data.root, "Add data.root=RECORDINGS.")


@command(config_folder(), "convert", check)
def main(config: DictConfig) -> None:
    """Convert, and tell what was kept and what was rejected."""
    from data_converters import ConversionSettings, ResampleSettings, convert
    from data_converters.summary import summary

    settings = ConversionSettings(
        dataset=instantiate(config.data.recordings),
        cache=Path(config.data.cache),
        resample=ResampleSettings(
            dt_s=config.dt_s,
            max_gap_s=config.max_gap_s,
            min_duration_s=config.min_duration_s,
            smoother=instantiate(config.smoother),
            backfill_heading=config.backfill_heading,
        ),
        workers=config.workers,
        strict=config.strict,
        replace=config.replace,
    )
    report = convert(settings)
    logger.info("\n%s\n", summary(report))
    logger.info("Report: %s", settings.cache / REPORT_FILE)


if __name__ == "__main__":
    main()
