"""Files of checkpoints: written whole beside the earlier one, which then goes."""

from io import BytesIO
from pathlib import Path
from typing import Any

import torch
from lightning_fabric.plugins import TorchCheckpointIO

from dmmv_conventions.disk import replacing


class WholeCheckpoints(TorchCheckpointIO):
    """Lightning's, which writes where temporary files lie and moves them from there.

    From another disk a file is not moved but copied, over the earlier checkpoint: a process that is
    killed meanwhile, or a full disk, would leave neither of the two.
    """

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any = None
    ) -> None:
        """Write a checkpoint all or nothing.

        Args:
            checkpoint: Its content.
            path: The file; its folder is made.
            storage_options: Of other kinds of storage.

        Raises:
            OSError: It cannot be written; the earlier file stays.
        """
        # torch itself would not say that a disk is full
        content = BytesIO()
        torch.save(checkpoint, content)
        with replacing(Path(path)) as unfinished:
            unfinished.write_bytes(content.getbuffer())
