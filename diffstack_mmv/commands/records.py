"""What a command hands to Weights & Biases when it has ended."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from diffstack_mmv.commands.cli import DictConfig, instantiate

if TYPE_CHECKING:
    from collections.abc import Mapping

    from diffstack_mmv.metrics.scores import Score


def log_record(config: DictConfig, open_loop: Mapping[str, Score] | None = None) -> None:
    """Log what `dmmv-report` shows of the folder of a run, if the configuration asks for it.

    Args:
        config: Configuration of the command, with `out` and `wandb`.
        open_loop: Scores of predictions and plans; all of them if None.
    """
    if not config.get("wandb"):
        return
    from diffstack_mmv.metrics import CLOSED_LOOP, OPEN_LOOP
    from diffstack_mmv.reporting.html import Titles, read_record

    titles = Titles(OPEN_LOOP if open_loop is None else open_loop, CLOSED_LOOP)
    instantiate(config.wandb)(read_record(Path(config.out), titles))
