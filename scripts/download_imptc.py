"""Fetch IMPTC from its public record."""

import logging
from pathlib import Path

from omegaconf import DictConfig

from data_converters.imptc.download import Part, download_imptc
from diffstack_mmv.checks import require_one_of
from diffstack_mmv.cli import command
from diffstack_mmv.vehicles import config_folder

logger = logging.getLogger(__name__)


@command(config_folder(), "download_imptc")
def main(config: DictConfig) -> None:
    """Download, check and unpack; a broken download goes on where it stopped."""
    require_one_of("parts", config.parts, [part.value for part in Part])
    folders = download_imptc(Path(config.out), [Part(config.parts)])
    logger.info("Unpacked %s", ", ".join(str(folder) for folder in folders))


if __name__ == "__main__":
    main()
