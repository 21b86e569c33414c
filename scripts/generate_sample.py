"""Generate synthetic recordings in IMPTC's layout."""

import logging
from pathlib import Path

from diffstack_mmv.commands.cli import DictConfig, command
from dmmv_conventions.checks import require
from dmmv_conventions.configs import config_folder

logger = logging.getLogger(__name__)


def check(config: DictConfig) -> None:
    """Refuse what is no list of sequence numbers."""
    numbers = list(config.sequences)
    fits = len(numbers) > 0 and all(isinstance(number, int) for number in numbers)
    require(fits, "sequences", "be a list of one or more whole numbers", numbers)


def admit(config: DictConfig) -> None:
    """Refuse a folder that holds one of the sequences."""
    remedy = "Choose another folder or remove it."
    for number in config.sequences:
        found = [path.name for path in Path(config.out).glob(f"{number:04d}_*")]
        where = f"in {config.out}"
        require(not found, "out", "not hold the sequence yet", " ".join(found), where, remedy)


@command(config_folder(), "generate_sample", check, admit)
def main(config: DictConfig) -> None:
    """Write the sample."""
    from data_converters import generate_sample

    folders = generate_sample(
        Path(config.out), config.seed, list(config.sequences), config.duration_s
    )
    logger.info("Wrote %d sequences to %s", len(folders), config.out)


if __name__ == "__main__":
    main()
