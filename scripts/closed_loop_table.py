"""A table of closed-loop drives by one command."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diffstack_mmv.commands.cli import DictConfig, OmegaConf, command, instantiate, settings_in
from diffstack_mmv.commands.command_line import quoted
from diffstack_mmv.commands.config_checks import require_checkpoint
from diffstack_mmv.commands.data_checks import Conversion, require_conversions
from diffstack_mmv.commands.jobs import Job
from diffstack_mmv.commands.table_jobs import TableJobs, require_same_jobs
from dmmv_conventions.checks import require
from dmmv_conventions.configs import config_folder

if TYPE_CHECKING:
    from diffstack_mmv.reporting import DrivenRow

logger = logging.getLogger(__name__)

NAVIGATE = Path(__file__).resolve().parent / "navigate.py"
ALONE = ("beside=[]", "wandb=none", "animate=0")
"""Each drive is one row: baselines are rows of their own, and nothing is drawn."""


def check(config: DictConfig) -> None:
    """Refuse rows and places that the table does not have, and drives that lack their data.

    What is left can be told without them.
    """
    table = config.table
    for name in ("rows", "places"):
        _require_some_of(name, config[name], table[name])
    for name, keys in (("drives", table.places), ("against", table.rows)):
        told = table.get(name) or {}
        _require_some_of(f"table.{name}", told, keys)
        for key, rows in told.items():
            _require_some_of(f"table.{name}.{key}", rows, table.rows)
    instantiate(config.launcher)
    if not config.dry_run:
        _require_read(config)


def _require_some_of(argument: str, names: Iterable[Any] | None, known: Iterable[Any]) -> None:
    """Refuse names that the table does not have; without them it would lack lines in silence."""
    unknown = sorted(set(names or ()) - set(known))
    require(not unknown, argument, f"be some of {list(known)}", unknown)


def _require_read(config: DictConfig) -> None:
    """Refuse drives that lack what they read."""
    left = [row for row in _rows(config, Path(config.out)) if not row.result.is_file()]
    drives = [settings_in(_settings(config, row).values()) for row in left]
    require_conversions(each for drive in drives for each in _conversions(drive))
    for drive in drives:
        if _text(drive, "people") == "predictor":
            require_checkpoint("people_checkpoint", _text(drive, "people_checkpoint"))


def admit(config: DictConfig) -> None:
    """Refuse a folder with drives of other settings."""
    out = Path(config.out)
    require_same_jobs([_job(config, row, out) for row in _rows(config, out)])


@command(config_folder(), "closed_loop_table", check, admit)
def main(config: DictConfig) -> None:
    """Drive whatever has not been driven yet, then write the table.

    Raises:
        ValueError: A drive failed.
    """
    from diffstack_mmv.metrics import CLOSED_LOOP
    from diffstack_mmv.reporting import write_joint_table

    out = Path(config.out)
    rows = list(_rows(config, out))
    jobs = [_job(config, row, out) for row in rows]
    drives = TableJobs([jobs], instantiate(config.launcher), "table", "drive")
    drives.tell({"drive": config.expected_s})

    def write(remarks: list[str]) -> None:
        write_joint_table(out, config.table.title, rows, CLOSED_LOOP, remarks)
        logger.info("\n%s", (out / "table.md").read_text(encoding="utf-8"))

    if not config.dry_run:
        drives.complete(write)


def _rows(config: DictConfig, out: Path) -> Iterator[DrivenRow]:
    from diffstack_mmv.reporting import DrivenRow

    table = config.table
    for place in config.places or table.places:
        driven = (table.get("drives") or {}).get(place, list(table.rows))
        for name in (each for each in config.rows or table.rows if each in driven):
            against = tuple((table.get("against") or {}).get(name) or ())
            yield DrivenRow(str(place), str(name), out / "drives" / place / name, against)


def _job(config: DictConfig, row: DrivenRow, out: Path) -> Job:
    settings = _settings(config, row)
    drive = (sys.executable, str(NAVIGATE), *ALONE, *settings.values(), f"out={quoted(row.folder)}")
    log = out / "logs" / f"{row.place}.{row.name}.log"
    name = f"{row.place}, {row.name}"
    partial = row.folder / "episodes"
    return Job(
        name, "drive", (drive,), row.result, log, folder=row.folder, root=out, partial=partial
    )


def _settings(config: DictConfig, row: DrivenRow) -> dict[str, str]:
    """Key -> setting as it would be typed: a later one of a key replaces an earlier one."""
    table = config.table
    parts = table.settings, table.places[row.place], table.rows[row.name], config.overrides
    return {str(each).partition("=")[0]: str(each) for part in parts for each in part}


def _text(drive: Mapping[str, Any], key: str) -> str | None:
    """Value of a key as text, none where it is not given or none."""
    value = drive.get(key)
    return None if value is None else str(value)


def _conversions(drive: Mapping[str, Any]) -> Iterator[Conversion]:
    """The converted data set that a drive among recorded people reads."""
    file = config_folder() / "data" / f"{_text(drive, 'data')}.yaml"
    if not (_text(drive, "crowd") or "").startswith("replay") or not file.is_file():
        return
    config = OmegaConf.create({"data": OmegaConf.load(file)})
    # what has a module of its own reads the recordings themselves
    if "module" in config.data or "data.cache" not in drive:
        return
    for key in (key for key in drive if key.startswith("data.")):
        OmegaConf.update(config, key, drive[key])
    yield Conversion(str(config.data.name), Path(config.data.cache))


if __name__ == "__main__":
    main()
