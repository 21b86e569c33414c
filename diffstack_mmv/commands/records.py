"""What a command hands to Weights & Biases when it has ended."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diffstack_mmv.commands.cli import DictConfig, instantiate


def log_record(config: DictConfig, open_loop: Mapping[str, Any] | None = None) -> None:
    """Log what `dmmv-report` shows of the folder of a run, if the configuration asks for it.

    Args:
        config: Configuration of the command, with `out` and `wandb`.
        open_loop: The `Score` of predictions and plans by name; all of them if None.
    """
    if not config.get("wandb"):
        return
    from diffstack_mmv.metrics import CLOSED_LOOP, OPEN_LOOP
    from diffstack_mmv.reporting.html import Titles, read_record

    titles = Titles(OPEN_LOOP if open_loop is None else open_loop, CLOSED_LOOP)
    instantiate(config.wandb)(read_record(Path(config.out), titles))
