"""Training with several processes that leaves nothing behind in the one that began it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from torch import distributed


@contextmanager
def own_processes() -> Iterator[None]:
    """Close the process group of a run and restore the environment, so that another run may follow.

    Lightning tells its processes apart by variables of the environment and keeps the group open:
    the second run of a sweep would take itself for a member of the first and wait for the others.
    """
    before = dict(os.environ)
    try:
        yield
    finally:
        if distributed.is_available() and distributed.is_initialized():
            distributed.destroy_process_group()
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)
