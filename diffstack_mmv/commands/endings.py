"""Signals to end: exceptions, so that what runs is left in order, with the status of shells."""

import os
import signal
import sys
import threading
from _thread import interrupt_main
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

_AGAIN_S = 0.5


class ToldToEndError(SystemExit):
    """A process was told to end; its status is 128 and the number of the signal."""

    def __init__(self, number: int) -> None:
        super().__init__(128 + number)
        self.told = _told(number)


@contextmanager
def endings_raised() -> Iterator[None]:
    """Have signals to end raise an exception, as Ctrl-C does: files and processes are then left.

    Packages may swallow it: it is raised again until this is left. Within an import the process
    ends at once, as some go on without the half that is missing. A signal that is ignored, as under
    nohup, or that somebody else answers, stays so.

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
        self._left, self._leaving = threading.Event(), threading.Lock()
        self._process = os.getpid()
        self._raised: BaseException | None = None
        self._again = False

    def end(self, number: int, frame: FrameType | None) -> None:
        """Answer a signal."""
        if os.getpid() != self._process:
            _end_forked(number, frame)
        again, self._again = self._again, False
        # what is put in order meanwhile is not interrupted, but by who asks a second time
        if again and _handled(self._raised):
            return
        if _importing(frame):
            os.write(2, _told(number).encode())
            os._exit(128 + number)
        if self._raised is None:
            threading.Thread(target=self._repeat, args=(number,), daemon=True).start()
        interrupted = number == signal.SIGINT
        self._raised = KeyboardInterrupt() if interrupted else ToldToEndError(number)
        raise self._raised

    def leave(self) -> None:
        """Raise nothing any more."""
        with self._leaving:
            self._left.set()

    def _repeat(self, number: int) -> None:
        while not self._left.wait(_AGAIN_S):
            with self._leaving:
                if not self._left.is_set():
                    self._again = True
                    _signal_main_thread(number)


def _signal_main_thread(number: int) -> None:
    if hasattr(signal, "pthread_kill"):  # it ends a wait, too, but Windows has none
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        interrupt_main(signal.Signals(number))


def _handled(error: BaseException | None) -> bool:
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
