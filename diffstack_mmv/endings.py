"""Signals to end: exceptions, so that what runs is left in order, with the status of shells."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

USUAL = {
    "SIGINT": signal.default_int_handler,  # Ctrl-C
    "SIGTERM": signal.SIG_DFL,
    "SIGHUP": signal.SIG_DFL,  # a terminal that is closed; unknown to Windows
}
"""Signals to end, and what answers them where nobody has said otherwise."""


class ToldToEndError(SystemExit):
    """A process was told to end; its status is 128 and the number of the signal."""

    def __init__(self, number: int) -> None:
        super().__init__(128 + number)
        self.told = _told(number)


@contextmanager
def endings_raised() -> Iterator[None]:
    """Have signals to end raise an exception, as Ctrl-C does: files and processes are then left.

    Within an import all of them end the process at once: packages swallow what interrupts their
    imports, or go on without the half that is missing. A signal that is ignored, as under nohup, or
    that somebody else answers, stays so.

    Raises:
        ToldToEndError: SIGTERM or SIGHUP came.
        KeyboardInterrupt: SIGINT came.
    """
    before: dict[signal.Signals, Any] = {}
    process = os.getpid()

    def end(number: int, frame: FrameType | None) -> None:
        if os.getpid() == process:
            _end(number, frame)
        _end_forked(number, frame)

    if threading.current_thread() is threading.main_thread():
        for name, usual in USUAL.items():
            number = getattr(signal.Signals, name, None)
            if number is not None and signal.getsignal(number) is usual:
                before[number] = signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _end(number: int, frame: FrameType | None) -> None:
    if _importing(frame):
        os.write(2, _told(number).encode())
        os._exit(128 + number)
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise ToldToEndError(number)


def _end_forked(number: int, frame: FrameType | None) -> None:
    """What a process that was forked off does, as a worker of a loader: the usual."""
    if number == signal.SIGINT:
        signal.default_int_handler(number, frame)
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _told(number: int) -> str:
    interrupted = number == signal.SIGINT
    return "Interrupted.\n" if interrupted else f"Ended by {signal.Signals(number).name}.\n"
