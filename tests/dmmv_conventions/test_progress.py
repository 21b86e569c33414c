"""Long work is shown on a terminal while it lasts, and nowhere else."""

import io
import time

import pytest

from dmmv_conventions import bars
from dmmv_conventions.bars import Bars
from dmmv_conventions.progress import Silent, counted, shown_by, waiting


class Screen(io.StringIO):
    """Keeps what is written to it, as a terminal or as a file."""

    def __init__(self, terminal):
        super().__init__()
        self.terminal = terminal

    def isatty(self):
        return self.terminal


@pytest.fixture
def screen(monkeypatch):
    """Replace the error stream and quicken the clock."""
    monkeypatch.setattr(bars, "PERIOD_S", 0.02)

    def show(terminal):
        found = Screen(terminal)
        monkeypatch.setattr("sys.stderr", found)
        return found

    return show


def wait():
    with waiting("compile"):
        time.sleep(0.15)


def count():
    for _ in counted(iter("abc"), "search", "case", 3):
        time.sleep(0.06)


def test_a_clock_runs_while_something_is_waited_for(screen):
    seen = screen(True)
    with shown_by(Bars()):
        wait()
    shown = [part for part in seen.getvalue().split("\r") if "compile [00:00]" in part]
    assert len(shown) >= 3


def test_a_bar_tells_how_many_and_how_fast(screen):
    seen = screen(True)
    with shown_by(Bars()):
        count()
    shown = seen.getvalue()
    assert "search:   0%" in shown
    assert "| 2/3 [" in shown
    assert "case/s]" in shown or "s/case]" in shown


@pytest.mark.parametrize("work", [wait, count])
@pytest.mark.parametrize(
    ("terminal", "progress", "rank"),
    [(False, Bars, "0"), (True, Silent, "0"), (True, Bars, "1")],
    ids=["a file", "a library", "a second process"],
)
def test_nothing_is_shown_elsewhere(screen, monkeypatch, work, terminal, progress, rank):
    monkeypatch.setenv("LOCAL_RANK", rank)
    seen = screen(terminal)
    with shown_by(progress()):
        work()
    assert seen.getvalue() == ""


@pytest.mark.parametrize("work", [wait, count])
def test_a_line_is_left_empty_also_after_a_failure(screen, monkeypatch, work):
    def fail(seconds):
        raise ZeroDivisionError

    monkeypatch.setattr("time.sleep", fail)
    seen = screen(True)
    with shown_by(Bars()), pytest.raises(ZeroDivisionError):
        work()
    assert seen.getvalue().endswith("\r")
    assert seen.getvalue().split("\r")[-2].strip() == ""


def test_an_inner_listener_gives_way_to_the_outer_one(screen):
    seen = screen(True)
    with shown_by(Bars()):
        with shown_by(Silent()):
            wait()
        assert seen.getvalue() == ""
        wait()
    assert "compile" in seen.getvalue()
