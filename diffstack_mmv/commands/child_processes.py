"""Commands in processes that are told to end when the one that started them is, or is gone."""

import os
import signal
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import IO, Self

from diffstack_mmv.commands.endings import endings_raised

_PARENT = "DMMV_PARENT"
"""Environment variable with the number of the process that started a command."""


class ChildProcesses:
    """Runs commands, and has those that still run save and end before it is left.

    Within it a signal to end is an exception, as Ctrl-C is, so that it is left in order. Commands
    have a session of their own: Ctrl-C in a terminal would otherwise reach them too, and what they
    do about it would be interrupted by the signal that they get from here.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: set[subprocess.Popen[bytes]] = set()
        self._ended = False
        self._signals = ExitStack()

    def __enter__(self) -> Self:
        self._signals.enter_context(endings_raised())
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._ended = True
            running = list(self._running)
        for process in running:
            process.terminate()
        for process in running:
            process.wait()  # who runs one without a pool of threads would not wait for it to save
        self._signals.close()

    def run(
        self, command: Sequence[str], output: IO[str], environment: Mapping[str, str]
    ) -> int | None:
        """Run a command to its end; returns its exit status, None if it was not begun any more."""
        with self._lock:
            if self._ended:
                return None
            told = {**environment, _PARENT: str(os.getpid())}
            process = subprocess.Popen(
                command, stdout=output, stderr=output, env=told, start_new_session=True
            )
            self._running.add(process)
        code = process.wait()
        with self._lock:
            self._running.discard(process)
        return code


def end_with_parent() -> None:
    """Have this process save and end once the `ChildProcesses` that run it are gone.

    Killed, they tell nobody: what goes on would hold its folder against the next try.
    """
    parent = os.environ.pop(_PARENT, None)  # not for what this process starts itself
    if parent is not None:
        threading.Thread(target=_watch, args=(int(parent),), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.5)
    os.kill(os.getpid(), signal.SIGTERM)
