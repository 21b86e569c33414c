"""One page to look at, from the folders of finished runs."""

import logging
import sys
from pathlib import Path

from diffstack_mmv.commands.cli import DictConfig, command, folders_as
from diffstack_mmv.commands.run_checks import require_results
from dmmv_conventions.checks import require, require_at_least
from dmmv_conventions.configs import config_folder

logger = logging.getLogger(__name__)


def check(config: DictConfig) -> None:
    """Refuse folders without results, and to write into one of them."""
    require_results(config.runs)
    inside = Path(config.out).resolve() in [Path(run).resolve() for run in config.runs]
    require_at_least("episodes", config.episodes, 0)
    require(not Path(config.page).is_dir(), "page", "be a file", config.page, "", "Name it.")
    require(not inside, "out", "be a folder of its own", config.out, "", "Choose another `out`.")


@command(config_folder(), "report", check)
def report(config: DictConfig) -> None:
    """Read what the runs wrote, and write one HTML file that needs nothing else."""
    from diffstack_mmv.metrics import CLOSED_LOOP, EVALUATED
    from diffstack_mmv.reporting.html import Titles, names_apart, read_page, write_page

    titles = Titles(EVALUATED, CLOSED_LOOP)
    beside = None if config.beside is None else Path(config.beside)
    folders = [Path(run) for run in config.runs]
    pages = [
        read_page(folder, titles, config.episodes, beside)._replace(name=name)
        for folder, name in zip(folders, names_apart(folders), strict=True)
    ]
    write_page(Path(config.page), pages)
    logger.info("Page: %s", config.page)


def main() -> None:
    """The command, which also takes the folders alone: report.py RUN..."""
    sys.argv[1:] = folders_as("runs", sys.argv[1:])
    report()


if __name__ == "__main__":
    main()
