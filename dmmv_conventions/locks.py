"""One writer at a time: locks on folders, which the system releases even if a process dies."""

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from dmmv_conventions.checks import message

logger = logging.getLogger(__name__)

LOCK_FILE = ".lock"
_RANKS = ("LOCAL_RANK", "RANK", "SLURM_PROCID")


def is_first_process() -> bool:
    """Whether this is the first of the processes of a run, or the only one."""
    return all(os.environ.get(rank, "0") == "0" for rank in _RANKS)


@contextmanager
def alone_in(folder: Path, argument: str) -> Iterator[None]:
    """Be the only process that works in a folder; processes that a run starts belong to it.

    Args:
        folder: The folder; it is made.
        argument: Name of the setting that names it, for the message.

    Raises:
        ValueError: Another process works in it.
    """
    if not is_first_process():
        yield
        return
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / LOCK_FILE, timeout=0)
    try:
        lock.acquire()
    except Timeout as taken:
        remedy = f"Wait until it has finished, or choose another `{argument}`."
        needs, found = "be a folder that no other process writes to", f"{folder}, which one does"
        raise ValueError(message(argument, needs, found, "", remedy)) from taken
    try:
        yield
    finally:
        lock.release()


@contextmanager
def in_turn(folder: Path, name: str) -> Iterator[None]:
    """Wait until no other process writes `name` in a folder, then be the one that does.

    Args:
        folder: The folder; it is made.
        name: What is written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / f"{LOCK_FILE}_{name}", timeout=0)
    try:
        lock.acquire()
    except Timeout:
        logger.info("Another process writes '%s' to %s: waiting for it.", name, folder)
        lock.acquire(timeout=-1)
    try:
        yield
    finally:
        lock.release()
