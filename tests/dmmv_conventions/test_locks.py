"""One writer at a time."""

import multiprocessing
import time

import pytest

from dmmv_conventions.locks import alone_in, in_turn


def test_the_second_process_is_refused_with_one_message(tmp_path):
    with (
        alone_in(tmp_path, "out"),
        pytest.raises(ValueError, match="`out` must be a folder that no other process writes to"),
        alone_in(tmp_path, "out"),
    ):
        pass
    with alone_in(tmp_path, "out"):
        pass


def test_processes_that_a_run_starts_belong_to_it(tmp_path, monkeypatch):
    with alone_in(tmp_path, "out"):
        monkeypatch.setenv("LOCAL_RANK", "1")
        with alone_in(tmp_path, "out"):
            pass


def _hold(folder, seconds, entered):
    with in_turn(folder, "thab_vru"):
        entered.set()
        time.sleep(seconds)


def test_the_second_process_waits_for_the_cache(tmp_path):
    context = multiprocessing.get_context("fork")
    entered = context.Event()
    other = context.Process(target=_hold, args=(tmp_path, 0.3, entered))
    other.start()
    entered.wait(5.0)
    begin = time.monotonic()
    with in_turn(tmp_path, "imptc"):
        assert time.monotonic() - begin < 0.2
    with in_turn(tmp_path, "thab_vru"):
        assert time.monotonic() - begin > 0.2
    other.join()


def test_a_lock_ends_with_the_process_that_held_it(tmp_path):
    context = multiprocessing.get_context("fork")
    entered = context.Event()
    other = context.Process(target=_hold, args=(tmp_path, 60.0, entered))
    other.start()
    entered.wait(5.0)
    other.kill()
    other.join()
    with in_turn(tmp_path, "thab_vru"):
        pass
