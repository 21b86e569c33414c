"""Bars of a command on its terminal; where there is no terminal, nothing but the log is written."""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import TypeVar

from dmmv_conventions.extras import needs

with needs("stack", "bars of progress"):
    from tqdm import tqdm

T = TypeVar("T")
PERIOD_S = 0.5
"""Time between two looks at a clock that somebody watches."""


class Bars:
    """Shows progress by bars, those of the first process alone where several train together."""

    def __init__(self) -> None:
        # none: only where there is a terminal
        self.disable = None if os.environ.get("LOCAL_RANK", "0") == "0" else True

    @contextmanager
    def waiting(self, title: str) -> Iterator[None]:
        """A clock that runs until the block ends, whatever the block does meanwhile."""
        told = "{desc} [{elapsed}]"
        with tqdm(desc=title, bar_format=told, leave=False, disable=self.disable) as bar:
            if bar.disable:
                yield
                return
            ended = Event()
            clock = Thread(target=_tick, args=(bar, ended), name="clock", daemon=True)
            clock.start()
            try:
                yield
            finally:
                ended.set()
                clock.join()

    def counted(self, items: Iterable[T], title: str, unit: str, total: int | None) -> Iterable[T]:
        """A bar with the rate, which goes with the loop, also if that ends early."""
        kept = {"leave": False, "disable": self.disable}
        return tqdm(items, desc=title, unit=unit, total=total, **kept)


def _tick(bar: tqdm, ended: Event) -> None:
    while not ended.wait(PERIOD_S):
        bar.refresh()
