"""Signals to end: exceptions, so that what runs is left in order, with the status of shells."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, NoReturn

USUAL = {
    "SIGINT": signal.default_int_handler,  # Ctrl-C
    "SIGTERM": signal.SIG_DFL,
    "SIGHUP": signal.SIG_DFL,  # a terminal that is closed; unknown to Windows
}
"""Signals to end, and what answers them where nobody has said otherwise."""

_AGAIN_S = 0.5
"""After which an exception that was swallowed is raised again."""


class ToldToEndError(SystemExit):
    """A process was told to end; its status is 128 and the number of the signal."""

    def __init__(self, number: int) -> None:
        super().__init__(128 + number)
        self.told = _told(number)


@contextmanager
def endings_raised() -> Iterator[None]:
    """Have signals to end raise an exception, as Ctrl-C does: files and processes are then left.

    Such an exception may be swallowed, and the command then goes on. Within an import the process
    ends at once: the initialisation of torch clears whatever ended its import of numpy, and goes on
    with half of it (3 of 60 starts that were interrupted within 4 s). Elsewhere the exception is
    raised again until this is left: Python ignores what is raised in `__del__` and in callbacks of
    weak references, which are called all the time (1 of 120 starts, a tuning). Windows has no timer
    for that.

    A signal that is ignored, as under nohup, or that somebody else answers, stays so.

    Raises:
        ToldToEndError: SIGTERM or SIGHUP came.
        KeyboardInterrupt: SIGINT came.
    """
    before: dict[signal.Signals, Any] = {}
    endings = _Endings()
    if threading.current_thread() is threading.main_thread():
        for name, usual in USUAL.items():
            number = getattr(signal.Signals, name, None)
            if number is not None and signal.getsignal(number) is usual:
                before[number] = signal.signal(number, endings.end)
    try:
        yield
    finally:
        endings.leave()
        for number, handler in before.items():
            signal.signal(number, handler)


class _Endings:
    """Raises an exception for a signal, and again where it was swallowed."""

    def __init__(self) -> None:
        self._process = os.getpid()
        self._number, self._raised = 0, BaseException()
        self._unraisable = sys.unraisablehook
        self._alarm: Any = None

    def end(self, number: int, frame: FrameType | None) -> NoReturn:
        """Answer a signal to end."""
        if os.getpid() != self._process:
            _end_forked(number, frame)
        if not self._number:
            sys.unraisablehook = self._swallowed
            if hasattr(signal, "setitimer"):
                self._alarm = signal.signal(signal.SIGALRM, self._again)
                signal.setitimer(signal.ITIMER_REAL, _AGAIN_S, _AGAIN_S)
        self._number = number
        self._raise(frame)

    def leave(self) -> None:
        """Raise nothing any more."""
        if self._number:
            sys.unraisablehook = self._unraisable
            if hasattr(signal, "setitimer"):
                signal.setitimer(signal.ITIMER_REAL, 0)
                signal.signal(signal.SIGALRM, self._alarm)

    def _again(self, _: int, frame: FrameType | None) -> None:
        # what is put in order because of the signal is interrupted by who asks a second time alone
        if not _handled(self._raised):
            self._raise(frame)

    def _raise(self, frame: FrameType | None) -> NoReturn:
        if _importing(frame):
            os.write(2, _told(self._number).encode())
            os._exit(128 + self._number)
        interrupted = self._number == signal.SIGINT
        self._raised = KeyboardInterrupt() if interrupted else ToldToEndError(self._number)
        raise self._raised

    def _swallowed(self, unraisable: Any) -> None:
        """Python prints what it ignores, but this is raised again."""
        if unraisable.exc_value is not self._raised:
            self._unraisable(unraisable)


def _handled(error: BaseException) -> bool:
    """Whether the main thread is leaving what it did because of an exception."""
    found = sys.exc_info()[1]
    while found is not None and found is not error:
        found = found.__context__
    return found is not None


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
