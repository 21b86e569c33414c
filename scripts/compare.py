"""Compare evaluated runs over dynamics, modes and seeds."""

import logging
from pathlib import Path

from diffstack_mmv.commands.cli import DictConfig, command
from diffstack_mmv.commands.records import log_record
from diffstack_mmv.commands.run_checks import require_reports
from dmmv_conventions.checks import require_one_of
from dmmv_conventions.configs import config_folder

logger = logging.getLogger(__name__)


def check(config: DictConfig) -> None:
    """Refuse folders without a report, and a score that nobody computes."""
    require_reports(config.runs)
    from diffstack_mmv.metrics import OPEN_LOOP

    require_one_of("score", config.score, tuple(OPEN_LOOP))


def admit(config: DictConfig) -> None:
    """Refuse a score that a report does not have."""
    from diffstack_mmv.reporting import require_score

    require_score([Path(run) for run in config.runs], config.score)


@command(config_folder(), "compare", check, admit)
def main(config: DictConfig) -> None:
    """Read what evaluate.py wrote and write one table."""
    from diffstack_mmv.metrics import EXCITATION, OPEN_LOOP
    from diffstack_mmv.plotting import save_by_excitation
    from diffstack_mmv.reporting import (
        bootstrap,
        compare,
        markdown_table,
        paired_samples,
        paired_tests,
        read_runs,
        write_by_excitation,
        write_comparison,
    )

    folders = [Path(run) for run in config.runs]
    comparison = compare(read_runs(folders), OPEN_LOOP)
    tests = paired_tests(folders, OPEN_LOOP[config.score])
    write_comparison(Path(config.out), comparison, tests)
    paired = paired_samples(folders, config.score, EXCITATION)
    write_by_excitation(Path(config.out), paired)
    titles = {each.name: each.heading for each in EXCITATION}
    heading, picture = OPEN_LOOP[config.score].heading, Path(config.out) / "excitation.png"
    save_by_excitation(picture, paired.by_setting(), paired.models, titles, heading, bootstrap)
    logger.info("\n%s", markdown_table(comparison.table))
    log_record(config)
    places = " ".join(str(run) for run in (config.out, *config.runs))
    logger.info("As a page: dmmv-report %s", places)


if __name__ == "__main__":
    main()
