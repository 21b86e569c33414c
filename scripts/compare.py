"""Compare evaluated runs over dynamics, modes and seeds."""

import logging
from pathlib import Path

from omegaconf import DictConfig

from diffstack_mmv.cli import command
from diffstack_mmv.reporting import compare, paired_tests, read_runs, write_comparison
from diffstack_mmv.vehicles import config_folder

logger = logging.getLogger(__name__)


@command(config_folder(), "compare")
def main(config: DictConfig) -> None:
    """Read what evaluate.py wrote and write one table."""
    folders = [Path(run) for run in config.runs]
    table = compare(read_runs(folders))
    write_comparison(Path(config.out), table, paired_tests(folders, config.score))
    logger.info("\n%s", table.to_markdown(index=False))


if __name__ == "__main__":
    main()
