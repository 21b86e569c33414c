"""A table of closed-loop drives by one command."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from diffstack_mmv.cli import DictConfig, command, instantiate
from diffstack_mmv.command_line import quoted
from diffstack_mmv.jobs import Job
from diffstack_mmv.table_jobs import TableJobs, require_same_jobs
from dmmv_conventions.checks import require
from dmmv_conventions.configs import config_folder

if TYPE_CHECKING:
    from diffstack_mmv.reporting import DrivenRow

logger = logging.getLogger(__name__)

NAVIGATE = Path(__file__).resolve().parent / "navigate.py"
ALONE = ("beside=[]", "wandb=none", "animate=0")
"""Each drive is one row: baselines are rows of their own, and nothing is drawn."""


def check(config: DictConfig) -> None:
    """Refuse a choice of rows or places that the table does not have."""
    for name in ("rows", "places"):
        known = list(config.table[name])
        unknown = sorted(set(config[name] or ()) - set(known))
        require(not unknown, name, f"be some of {known}", unknown)
    instantiate(config.launcher)


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
    table = config.table
    parts = table.settings, table.places[row.place], table.rows[row.name], config.overrides
    settings = [setting for part in parts for setting in part]
    # as they would be typed: a later setting of the same key replaces an earlier one
    last = {setting.split("=", 1)[0]: setting for setting in settings}
    drive = (sys.executable, str(NAVIGATE), *ALONE, *last.values(), f"out={quoted(row.folder)}")
    log = out / "logs" / f"{row.place}.{row.name}.log"
    name = f"{row.place}, {row.name}"
    partial = row.folder / "episodes"
    return Job(
        name, "drive", (drive,), row.result, log, folder=row.folder, root=out, partial=partial
    )


if __name__ == "__main__":
    main()
