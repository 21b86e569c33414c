"""Generate synthetic recordings in IMPTC's layout."""

import logging
from pathlib import Path

from diffstack_mmv.cli import DictConfig, command
from dmmv_conventions.configs import config_folder

logger = logging.getLogger(__name__)


@command(config_folder(), "generate_sample")
def main(config: DictConfig) -> None:
    """Write the sample."""
    from data_converters import generate_sample

    folders = generate_sample(
        Path(config.out), config.seed, list(config.sequences), config.duration_s
    )
    logger.info("Wrote %d sequences to %s", len(folders), config.out)


if __name__ == "__main__":
    main()
