"""The table of a run, row by row as if it had never been interrupted."""

import csv
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytorch_lightning as pl
import torch
from pytorch_lightning.callbacks import Callback
from pytorch_lightning.loggers import CSVLogger
from pytorch_lightning.loggers.csv_logs import ExperimentWriter
from pytorch_lightning.loggers.logger import rank_zero_experiment

from dmmv_conventions.disk import replacing

_KEY = "csv_rows"

Row = Mapping[str, Any]


class _KeepingWriter(ExperimentWriter):
    """Writes rows behind those of an earlier process; a kill never loses a row that was there."""

    def __init__(self, log_dir: str) -> None:
        super().__init__(log_dir)
        self.written = self._read()
        self.metrics_keys = list(self.written[0]) if self.written else []

    def _check_log_dir_exists(self) -> None:
        """Leave the earlier rows alone: `keep` decides how many are taken over."""

    def save(self) -> None:
        """Append the rows that are waiting."""
        self.written += [dict(row) for row in self.metrics]
        super().save()

    def keep(self, count: int | None, more: Sequence[Row] = ()) -> None:
        """Take over the first `count` rows, all if None, and add `more`."""
        self.written = [*self.written[:count], *map(dict, more)]
        self.metrics_keys = sorted(set().union(*self.written)) if self.written else []
        self._rewrite_with_new_header(self.metrics_keys)

    def _rewrite_with_new_header(self, fieldnames: list[str]) -> None:
        """Write all earlier rows in one go; base: reads and writes the file in place."""
        rows = self.written[: len(self.written) - len(self.metrics)]
        path = Path(self.metrics_file_path)
        if not rows:
            path.unlink(missing_ok=True)
            return
        with (
            replacing(path) as unfinished,
            unfinished.open("w", newline="", encoding="utf-8") as stream,
        ):
            writer = csv.DictWriter(stream, fieldnames)
            writer.writeheader()
            writer.writerows(rows)

    def _read(self) -> list[dict[str, Any]]:
        """Earlier rows; the last one may have been cut off while it was written."""
        path = Path(self.metrics_file_path)
        if not path.is_file():
            return []
        with path.open(newline="", encoding="utf-8") as stream:
            return [row for row in csv.DictReader(stream) if None not in row.values()]


class ResumableCSVLogger(CSVLogger):
    """Lightning's logger of CSV files, which would delete the rows of an interrupted run.

    It belongs together with `KeptRows`.
    """

    @property
    @rank_zero_experiment
    def experiment(self) -> _KeepingWriter:  # type: ignore[override]
        """What writes the file."""
        if self._experiment is None:
            os.makedirs(self.root_dir, exist_ok=True)
            self._experiment = _KeepingWriter(self.log_dir)
        return self._experiment  # type: ignore[return-value]


class KeptRows(Callback):
    """Continues the rows of an interrupted run where its checkpoint was saved.

    Rows up to the checkpoint are on disk before it is; rows behind it are dropped when the run
    resumes, because they are made again. The means of an epoch are logged only after its checkpoint
    was saved, so they are kept in it.
    """

    def __init__(self) -> None:
        self._loaded: dict[str, Any] | None = None

    def on_save_checkpoint(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Flush the rows, and store how many there are."""
        if not trainer.is_global_zero:
            return
        for logger in _loggers(trainer):
            logger.save()
            rows = len(logger.experiment.written)
            checkpoint[_KEY] = {"count": rows, "open": _means_of_epoch(trainer)}

    def on_load_checkpoint(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Remember how many rows belong to the checkpoint; older ones do not tell."""
        self._loaded = checkpoint.get(_KEY, {"count": None, "open": []})

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Take over the rows of the checkpoint, none in a new run."""
        kept = self._loaded or {"count": 0, "open": []}
        if trainer.is_global_zero:
            for logger in _loggers(trainer):
                logger.experiment.keep(kept["count"], kept["open"])


def _loggers(trainer: pl.Trainer) -> list[ResumableCSVLogger]:
    return [logger for logger in trainer.loggers if isinstance(logger, ResumableCSVLogger)]


def _means_of_epoch(trainer: pl.Trainer) -> list[dict[str, float]]:
    """The row that Lightning logs once the epoch is closed, if the epoch has ended."""
    loop: Any = trainer.fit_loop
    ended = loop.epoch_progress.current.processed > loop.epoch_progress.current.completed
    metrics: Mapping[str, Any] = trainer._logger_connector.metrics["log"] if ended else {}
    if not metrics:
        return []
    row = {name: float(torch.as_tensor(value)) for name, value in metrics.items()}
    step = loop.epoch_loop._batches_that_stepped - 1
    return [{"epoch": trainer.current_epoch} | row | {"step": step}]
