"""Faults in a worker of a data loader, raised as they are: torch would make a traceback of each."""

import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from torch.utils.data import get_worker_info

Item = TypeVar("Item")
Given = ParamSpec("Given")

_PASSED = ValueError, OSError
"""Faults that are passed on, no subclasses: another process may be unable to make those anew."""


@dataclass(frozen=True)
class _Fault:
    """What a worker hands out in place of an item."""

    error: Exception
    place: str  # traceback within the worker


def passing_faults(read: Callable[Given, Item]) -> Callable[Given, Item]:
    """Have a worker hand out the fault of an item, for `raising_faults`; elsewhere it is raised."""

    @wraps(read)
    def item(*args: Given.args, **kwargs: Given.kwargs) -> Any:
        try:
            return read(*args, **kwargs)
        except _PASSED as error:
            if get_worker_info() is None or type(error) not in _PASSED:
                raise
            return _Fault(error, traceback.format_exc())

    return item


def raising_faults(items: Iterable[Item]) -> Iterator[Item]:
    """The items of a loader.

    Raises:
        ValueError: One could not be read, in the words of the worker.
        OSError: So.
    """
    for item in items:
        if isinstance(item, _Fault):
            raise item.error from RuntimeError(item.place)
        yield item
