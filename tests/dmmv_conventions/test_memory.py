"""Freed memory is kept where the C library can."""

import ctypes
import gc
import subprocess
import sys

from dmmv_conventions import memory

REPEATED = """
import resource
from dmmv_conventions.memory import keep_freed

kept = keep_freed()
for _ in range(8):
    block = b"x" * 2**26
    del block
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
block = b"x" * 2**26
print(int(kept), resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def test_a_block_is_not_cleared_again():
    done = subprocess.run(
        [sys.executable, "-c", REPEATED], capture_output=True, text=True, check=True
    )
    kept, faults = map(int, done.stdout.split())
    assert not kept or faults < 2**10  # of 2**14 pages


def test_other_c_libraries_are_left_alone(monkeypatch):
    monkeypatch.setattr(ctypes, "CDLL", lambda _: object())
    assert not memory.keep_freed()


def test_what_exists_is_left_out_of_the_search_for_garbage():
    gc.unfreeze()  # as before tests/conftest.py did the same
    memory.leave_alone()
    assert gc.get_freeze_count() > 0
    assert len(gc.get_objects()) < gc.get_freeze_count()
