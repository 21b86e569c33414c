"""The results of a finished command as one W&B run."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import wandb

from diffstack_mmv.checks import require_switch


@runtime_checkable
class TableLike(Protocol):
    """A table."""

    @property
    def columns(self) -> Sequence[str]:
        """Headings."""
        ...

    @property
    def rows(self) -> Sequence[Sequence[str | float | None]]:
        """One entry per column."""
        ...


@runtime_checkable
class Results(Protocol):
    """What a command leaves behind."""

    @property
    def config(self) -> Mapping[str, Any]:
        """Its configuration."""
        ...

    @property
    def tables(self) -> Mapping[str, TableLike]:
        """Title -> table."""
        ...

    @property
    def numbers(self) -> Mapping[str, float]:
        """Name -> value."""
        ...

    @property
    def pictures(self) -> Mapping[str, Path]:
        """Name -> file."""
        ...


class WandbResults:
    """Logs tables, numbers and pictures; needs neither account nor network while offline.

    The environment variable WANDB_MODE, where it is set, decides instead of `offline`.

    Args:
        save_dir: Folder of the run; receives `wandb/`.
        project: Project of the run.
        kind: Job type: evaluate, navigate, identify, compare, ...
        offline: Whether it is kept on disk, to be uploaded later.
    """

    def __init__(self, save_dir: str, project: str, kind: str, offline: bool = True) -> None:
        require_switch("offline", offline)
        self.save_dir = save_dir
        self.project = project
        self.kind = kind
        self.mode = "offline" if offline else "online"

    def __call__(self, results: Results) -> None:
        """Log everything and finish the run."""
        mode: Any = os.environ.get("WANDB_MODE", self.mode)
        if mode == "disabled":
            return
        with wandb.init(
            project=self.project,
            dir=self.save_dir,
            job_type=self.kind,
            name=f"{self.kind}-{Path(self.save_dir).resolve().name}",
            config=dict(results.config),
            mode=mode,
            reinit="finish_previous",
            settings=wandb.Settings(silent=True, console="off"),
        ) as run:
            content: dict[str, Any] = {
                f"tables/{title}": wandb.Table(columns=list(told.columns), data=list(told.rows))
                for title, told in results.tables.items()
            }
            content |= {
                f"figures/{name}": wandb.Image(str(file))
                for name, file in results.pictures.items()
                if file.suffix == ".png"
            }
            run.log(content)
            run.summary.update(dict(results.numbers))
