"""Signals to end leave a command in order, with one line and the status of shells."""

import os
import signal
import subprocess
import sys

import pytest

# tests that run behind a shell may ignore them
USUAL = """
import os, signal, sys
from pathlib import Path
signal.signal(signal.SIGINT, signal.default_int_handler)
for name in ("SIGTERM", "SIGHUP"):
    signal.signal(getattr(signal, name), signal.SIG_DFL)
folder, sent = Path(sys.argv.pop(1)), signal.Signals[sys.argv.pop(1)]
"""
CONTENT = "out: out\nhydra: {run: {dir: '${out}'}, output_subdir: null}\n"
COMMAND = """
from diffstack_mmv.commands.cli import command
from dmmv_conventions.disk import replacing
def work(config):
    with replacing(folder / "result") as unfinished:
        unfinished.touch()
        os.kill(os.getpid(), sent)
command(folder, "task")(work)()
"""
# work that would go on, had the signal not come again; it ends after half a second
CARELESS_WORK = "time.sleep(20)"
# longer than the half second after which a signal comes again
PUTTING_IN_ORDER = "time.sleep(1.2)"
SWALLOWED = "try:\n    os.kill(os.getpid(), sent)\nexcept BaseException:\n    pass\n"
IMPORTING = f"""
from diffstack_mmv.commands.endings import endings_raised
(folder / "careless.py").write_text("import os\\nfrom __main__ import sent\\n" + {SWALLOWED!r})
sys.path.insert(0, str(folder))
with endings_raised():
    import careless
print("went on")
"""
CARELESS = f"""
import time
from diffstack_mmv.commands.endings import endings_raised
with endings_raised():
    {SWALLOWED.strip().replace(chr(10), chr(10) + " " * 4)}
    {CARELESS_WORK}
    print("went on")
"""
# as the callbacks of weak references, which are called all the time
IGNORED = COMMAND.replace(
    "        os.kill(os.getpid(), sent)",
    """        class Ignored:
            def __del__(self):
                os.kill(os.getpid(), sent)
        Ignored()
        time.sleep(20)
        print("went on")""",
).replace("\n", "\nimport time\n", 1)
SLOW = f"""
import time
from diffstack_mmv.commands.endings import endings_raised
with endings_raised():
    try:
        os.kill(os.getpid(), sent)
    finally:
        {PUTTING_IN_ORDER}
        print("in order")
"""
FORKED = f"""
from diffstack_mmv.commands.endings import endings_raised
with endings_raised():
    worker = os.fork()
    if worker == 0:
        {SWALLOWED.strip().replace(chr(10), chr(10) + " " * 8)}
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(worker, 0)[1]))
"""


def ended(program, folder, sent):
    """A process that sends a signal to itself, or to a worker."""
    words = [sys.executable, "-c", USUAL + program, str(folder), sent]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("sent", "status", "told"),
    [
        ("SIGINT", 130, "Interrupted.\n"),
        ("SIGTERM", 143, "Ended by SIGTERM.\n"),
        ("SIGHUP", 129, "Ended by SIGHUP.\n"),
    ],
)
def test_a_command_that_is_told_to_end_leaves_nothing_unfinished(sent, status, told, tmp_path):
    (tmp_path / "task.yaml").write_text(CONTENT)
    process = ended(COMMAND, tmp_path, sent)
    assert (process.returncode, process.stderr) == (status, told)
    assert not list(tmp_path.glob("result*"))


@pytest.mark.parametrize("sent", ["SIGINT", "SIGTERM"])
def test_an_import_that_swallows_a_signal_does_not_go_on(sent, tmp_path):
    process = ended(IMPORTING, tmp_path, sent)
    assert process.returncode == 128 + signal.Signals[sent]
    assert process.stdout == ""
    assert process.stderr in ("Interrupted.\n", "Ended by SIGTERM.\n")


@pytest.mark.parametrize("sent", ["SIGINT", "SIGTERM"])
def test_a_signal_that_was_swallowed_comes_again(sent, tmp_path):
    process = ended(CARELESS, tmp_path, sent)
    assert process.returncode != 0
    assert process.stdout == ""


def test_a_signal_that_python_ignores_comes_again_and_is_told_once(tmp_path):
    (tmp_path / "task.yaml").write_text(CONTENT)
    process = ended(IGNORED, tmp_path, "SIGTERM")
    assert (process.returncode, process.stderr) == (143, "Ended by SIGTERM.\n")
    assert process.stdout == ""
    assert not list(tmp_path.glob("result*"))


def test_what_is_put_in_order_is_not_interrupted(tmp_path):
    process = ended(SLOW, tmp_path, "SIGTERM")
    assert (process.returncode, process.stdout) == (143, "in order\n")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system forks no workers")
@pytest.mark.parametrize(("sent", "status"), [("SIGTERM", -signal.SIGTERM), ("SIGINT", 0)])
def test_workers_that_were_forked_off_answer_as_usual(sent, status, tmp_path):
    assert ended(FORKED, tmp_path, sent).stdout == f"{status}\n"


def test_who_ignores_a_signal_goes_on_doing_so(tmp_path):
    ignoring = "signal.signal(sent, signal.SIG_IGN)\n" + COMMAND
    (tmp_path / "task.yaml").write_text(CONTENT)
    process = ended(ignoring, tmp_path, "SIGHUP")
    assert (process.returncode, process.stderr) == (0, "")
    assert (tmp_path / "result").exists()
