"""Generate synthetic recordings in IMPTC's layout."""

import logging
from pathlib import Path

from diffstack_mmv.commands.cli import DictConfig, command
from diffstack_mmv.commands.run_checks import config_file
from dmmv_conventions.checks import require
from dmmv_conventions.configs import config_folder
from dmmv_conventions.yaml_files import read_plain

logger = logging.getLogger(__name__)


def check(config: DictConfig) -> None:
    """Refuse what is no list of sequence numbers."""
    numbers = list(config.sequences)
    fits = len(numbers) > 0 and all(isinstance(number, int) for number in numbers)
    require(fits, "sequences", "be a list of one or more whole numbers", numbers)


def admit(config: DictConfig) -> None:
    """Refuse a folder that holds one of the sequences, unless the same words have written it."""
    out, remedy = Path(config.out), "Choose another folder or remove it."
    file = config_file(out, "generate_sample")
    before = read_plain(file, "out", remedy) if file.is_file() else {}
    same = all(before.get(name) == config[name] for name in ("seed", "duration_s"))
    kept = before["sequences"] if same else []
    for number, found in _present(config).items():
        told = "not hold the sequence yet"
        require(number in kept, "out", told, " ".join(found), f"in {out}", remedy)


def _present(config: DictConfig) -> dict[int, list[str]]:
    """Names of the folders of each sequence that is there already."""
    found = {
        number: [path.name for path in Path(config.out).glob(f"{number:04d}_*")]
        for number in config.sequences
    }
    return {number: names for number, names in found.items() if names}


@command(config_folder(), "generate_sample", check, admit)
def main(config: DictConfig) -> None:
    """Write what is missing of the sample."""
    from data_converters import generate_sample

    present = _present(config)
    missing = [number for number in config.sequences if number not in present]
    folders = generate_sample(Path(config.out), config.seed, missing, config.duration_s)
    logger.info("Wrote %d sequences to %s, kept %d", len(folders), config.out, len(present))


if __name__ == "__main__":
    main()
