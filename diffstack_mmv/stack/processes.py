"""Training that leaves nothing behind in the process that began it, and ends as it was told."""

import os
import signal
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


@contextmanager
def interrupts_raised() -> Iterator[None]:
    """Have Ctrl-C end a training as it ends anything else.

    Lightning would leave with the status of a failure, and leave the signal switched off.

    Raises:
        KeyboardInterrupt: The training was interrupted.
    """
    handler = signal.getsignal(signal.SIGINT)
    try:
        yield
    except SystemExit as left:
        if not isinstance(left.__context__, KeyboardInterrupt):
            raise
        signal.signal(signal.SIGINT, handler)
        raise KeyboardInterrupt from None
