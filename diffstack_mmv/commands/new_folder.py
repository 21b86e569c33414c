"""The folder of a run that is given none: named after the time, and that of no other run."""

import itertools
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf, read_write

from diffstack_mmv.commands.command_line import NEW_FOLDER, quoted
from dmmv_conventions.locks import is_first_process


def declare_new_folders() -> None:
    """Have configurations name a new folder: `${new_folder:PATH}`."""
    OmegaConf.register_new_resolver("new_folder", str, replace=True)


class NewFolder(Callback):
    """Makes the folder of `out=${new_folder:PATH}` before the work begins.

    That is `PATH`, or the first of `PATH-2`, `PATH-3`, ... which nobody else has made: commands of
    one kind that start in the same second have a folder each. Further processes of a run are told
    it by the first, or share `PATH`. What cannot be made is left to Hydra, which tells why.
    """

    def on_run_start(self, config: DictConfig, **_: Any) -> None:
        """Make the folder of a run, unless it has another by `hydra.run.dir=DIR`."""
        written: Any = OmegaConf.to_container(OmegaConf.masked_copy(config, "out"))
        if str(written["out"]).startswith(NEW_FOLDER) and is_first_process():
            with _named_in(config), suppress(OSError):
                if config.hydra.run.dir == config.out:
                    config.out = str(_made(Path(config.out)))

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Make the folder of a sweep, and tell it to its jobs."""
        words: Any = OmegaConf.to_container(config.hydra.overrides.task)
        others = [word for word in words if not word.startswith(f"out={NEW_FOLDER}")]
        if len(others) < len(words) and is_first_process():
            with suppress(OSError), read_write(config.hydra):
                config.out = str(_made(Path(config.out)))
                config.hydra.overrides.task = [*others, f"out={quoted(config.out)}"]


def _made(folder: Path) -> Path:
    """Make a folder of this name, or with the first number behind it that is not taken."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    made = folder
    for number in itertools.count(2):
        try:
            made.mkdir()
            break
        except FileExistsError:
            made = folder.with_name(f"{folder.name}-{number}")
    return made


@contextmanager
def _named_in(config: DictConfig) -> Iterator[None]:
    """Let a configuration look up the name of its command, as within its job."""
    instance = HydraConfig.instance()
    before = instance.cfg
    instance.set_config(config)
    try:
        yield
    finally:
        instance.cfg = before
