"""Work that takes long says that it goes on; where nobody asked to be shown, it is silent."""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import Protocol, TypeVar, runtime_checkable

T = TypeVar("T")


@runtime_checkable
class Progress(Protocol):
    """Shows people how far something is."""

    def waiting(self, title: str) -> AbstractContextManager[object]:
        """Show the time that passes while something goes on of which nobody knows how long."""
        ...

    def counted(self, items: Iterable[T], title: str, unit: str, total: int | None) -> Iterable[T]:
        """Give the items one by one, and show how many have been dealt with."""
        ...


class Silent:
    """Shows nothing: the package as a library."""

    def waiting(self, title: str) -> AbstractContextManager[object]:
        """Nothing."""
        return nullcontext()

    def counted(self, items: Iterable[T], title: str, unit: str, total: int | None) -> Iterable[T]:
        """The items as they are."""
        return items


SILENT = Silent()
_shown: ContextVar[Progress] = ContextVar("shown")


@contextmanager
def shown_by(progress: Progress) -> Iterator[None]:
    """Have everything within the block, in this thread, shown.

    Args:
        progress: Who shows it.
    """
    before = _shown.set(progress)
    try:
        yield
    finally:
        _shown.reset(before)


def waiting(title: str) -> AbstractContextManager[object]:
    """Around work without steps that can be counted.

    Args:
        title: What is waited for.
    """
    return _shown.get(SILENT).waiting(title)


def counted(items: Iterable[T], title: str, unit: str, total: int | None = None) -> Iterable[T]:
    """The items of a loop that takes long.

    Args:
        items: What the loop goes through.
        title: What it does.
        unit: What an item is.
        total: How many there are, where the items do not tell.
    """
    return _shown.get(SILENT).counted(items, title, unit, total)
