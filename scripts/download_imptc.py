"""Fetch IMPTC from its public record."""

import logging
from pathlib import Path

from diffstack_mmv.commands.cli import DictConfig, command
from dmmv_conventions.checks import require_one_of
from dmmv_conventions.configs import config_folder

logger = logging.getLogger(__name__)


@command(config_folder(), "download_imptc")
def main(config: DictConfig) -> None:
    """Download, check and unpack; a broken download goes on where it stopped."""
    from data_converters.imptc.download import Part, download_imptc

    require_one_of("parts", config.parts, [part.value for part in Part])
    folders = download_imptc(Path(config.out), [Part(config.parts)])
    logger.info("Unpacked %s", ", ".join(str(folder) for folder in folders))


if __name__ == "__main__":
    main()
