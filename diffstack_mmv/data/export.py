"""Export: all samples of a split, read from trajdata once and written as arrays for training."""

import fcntl
import hashlib
import json
import logging
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch.utils.data import DataLoader
from tqdm import tqdm

from diffstack_mmv.checks import message
from diffstack_mmv.data.dataset import EXPORT_VERSION, MARKER, SAMPLES, USABLE, sample_table
from diffstack_mmv.data.export_chunks import LABELS, ChunkWriter
from diffstack_mmv.data.faults import raising_faults
from diffstack_mmv.data.layout import create, fields
from diffstack_mmv.data.loading import unchanged
from diffstack_mmv.data.registration import TrajdataWindows, WindowLocation
from diffstack_mmv.data.riding import Situations
from diffstack_mmv.data.settings import ExportSettings, WindowSettings
from diffstack_mmv.data.sources import WindowSource
from dmmv_conventions.disk import disk_is_full

logger = logging.getLogger(__name__)


class Export(NamedTuple):
    """One split of a data set with the settings of its windows."""

    source: WindowSource
    split: str
    windows: WindowSettings

    def key(self) -> dict[str, object]:
        """What decides the content: the recordings, their conversion, the windows."""
        return {
            "version": EXPORT_VERSION,
            "source": self.source.identity(),
            "split": self.split,
            "windows": self.windows.content(),
        }

    def exists(self, settings: ExportSettings) -> bool:
        """Whether this export is complete."""
        return (self.folder(settings) / MARKER).is_file()

    def folder(self, settings: ExportSettings) -> Path:
        """Folder of this export, named by a hash of its key."""
        text = json.dumps(self.key(), sort_keys=True, default=str)
        digest = hashlib.sha256(text.encode()).hexdigest()[:16]
        return Path(settings.folder).expanduser() / f"{self.source.name}_{self.split}_{digest}"


def export_windows(export: Export, settings: ExportSettings) -> Path:
    """Make an export unless it is there already.

    It grows in a hidden folder and takes its name when it is complete. A second process that asks
    for the same export waits; a later call goes on where an interrupted one stopped.

    Returns:
        The folder of the export.

    Raises:
        ValueError: The source cannot be opened, holds no window, or one of its files is damaged.
        OSError: The disk is full.
    """
    target = export.folder(settings)
    parent = target.parent
    if export.exists(settings):
        return target
    parent.mkdir(parents=True, exist_ok=True)
    with _locked(parent / f".{target.name}.lock"):
        if not export.exists(settings):
            try:
                _write(export, settings, target)
            except OSError as error:
                if not disk_is_full(error):
                    raise
                remedy = "Free space and run again: finished parts are kept."
                text = message(
                    "folder", "have free disk space", error.strerror, f"at {parent}", remedy
                )
                raise OSError(error.errno, text) from error
    return target


def _write(export: Export, settings: ExportSettings, target: Path) -> None:
    source = export.source.open(export.split, export.windows)
    where = source.locations()
    count = len(where.element)
    partial = target.with_name(f".exporting_{target.name}")
    _prepare(partial, count, export.windows)
    writer = ChunkWriter(source, where, partial)
    pending = [number for number in range(len(writer)) if not writer.marker(number).is_file()]
    loader = DataLoader(
        writer,
        batch_size=None,
        sampler=pending,
        num_workers=settings.workers,
        multiprocessing_context="fork" if settings.workers else None,
        collate_fn=unchanged,  # type: ignore[arg-type]
        # else a training that writes its export would go on with other random numbers
        generator=torch.Generator(),
    )
    title = f"export {export.source.name} {export.split}"
    with tqdm(total=count, desc=title, unit="window", disable=not settings.progress) as bar:
        bar.update(count - sum(writer.size(number) for number in pending))
        for number in raising_faults(loader):
            writer.marker(number).touch()
            bar.update(writer.size(number))
    _finish(export, source, where, partial)
    shutil.rmtree(target, ignore_errors=True)
    os.replace(partial, target)


def _prepare(partial: Path, count: int, windows: WindowSettings) -> None:
    """Create the array files, unless an interrupted export of the same key left them."""
    created = partial / "done"
    if created.is_dir():
        logger.info("going on with the interrupted export %s", partial)
        return
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    create(partial, count, fields(windows) | LABELS)
    created.mkdir()


def _finish(export: Export, source: TrajdataWindows, where: WindowLocation, partial: Path) -> None:
    usable = np.load(partial / USABLE)
    labels = dict(zip(Situations._fields, np.load(partial / "situations.npy").T, strict=True))
    sample_table(where, export.source.name).assign(**labels).to_parquet(
        partial / SAMPLES, index=False
    )
    for mode, count in zip(*np.unique(where.mode[~usable], return_counts=True), strict=True):
        source.counts.drop(int(mode), int(count))
    content: dict[str, Any] = {
        "version": EXPORT_VERSION,
        "key": export.key(),
        "windows": len(usable),
        "samples": int(usable.sum()),
        "rows": source.counts.as_dict(),
        "situations": {name: int(label[usable].sum()) for name, label in labels.items()},
    }
    (partial / MARKER).write_text(
        json.dumps(content, indent=1, default=str) + "\n", encoding="utf-8"
    )
    shutil.rmtree(partial / "done")


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock that the system releases even if this process dies."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
