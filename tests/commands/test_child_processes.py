"""What runs jobs leaves nothing running behind it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

LAUNCHER = """
import signal, sys
from pathlib import Path
from diffstack_mmv.commands.jobs import Job, LocalProcesses, run_job
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests that run behind a shell ignore it
signal.signal(signal.SIGHUP, signal.SIG_DFL)
folder = Path(sys.argv[1])
CHILD = '''
import signal, sys, time
from pathlib import Path
from diffstack_mmv.commands.child_processes import end_with_parent
folder, name = Path(sys.argv[1]), sys.argv[2]
def save(*_):
    time.sleep(0.3)
    (folder / f"{name}.saved").touch()
    raise SystemExit(1)
signal.signal(signal.SIGTERM, save)
end_with_parent()
(folder / f"{name}.begun").touch()
time.sleep(60)
(folder / name).touch()
'''
jobs = [
    Job(name, "kind", ((sys.executable, "-c", CHILD, str(folder), name),),
        folder / name, folder / f"{name}.log")
    for name in ("first", "second")
]
HOW
"""


POOL = "list(LocalProcesses(1)(jobs))"
ALONE = "run_job(jobs[0]); run_job(jobs[1])"  # as on a cluster


def started(folder: Path, how: str = POOL) -> "subprocess.Popen[bytes]":
    """A launcher with two jobs of a minute, one at a time, whose first job has begun."""
    launcher = subprocess.Popen([sys.executable, "-c", LAUNCHER.replace("HOW", how), str(folder)])
    limit = time.monotonic() + 60
    while not (folder / "first.begun").exists():
        assert launcher.poll() is None
        assert time.monotonic() < limit
        time.sleep(0.05)
    return launcher


@pytest.mark.parametrize("how", [POOL, ALONE], ids=["pool", "alone"])
@pytest.mark.parametrize(
    ("sent", "status"),
    [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, -signal.SIGINT)],
)
def test_a_signal_ends_what_runs_and_begins_nothing_else(tmp_path, sent, status, how):
    launcher = started(tmp_path, how)
    launcher.send_signal(sent)
    assert launcher.wait(timeout=30) == status
    assert (tmp_path / "first.saved").exists()
    assert not (tmp_path / "second.begun").exists()


def test_what_runs_ends_when_its_launcher_was_killed(tmp_path):
    launcher = started(tmp_path)
    launcher.kill()
    launcher.wait(timeout=30)
    limit = time.monotonic() + 30
    while not (tmp_path / "first.saved").exists():
        assert time.monotonic() < limit
        time.sleep(0.05)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="reads /proc")
def test_a_terminal_reaches_jobs_through_their_launcher_alone(tmp_path):
    launcher = started(tmp_path)
    ours = os.getpgid(launcher.pid)
    groups = {
        os.getpgid(int(place.name))
        for place in Path("/proc").iterdir()
        if place.name.isdigit() and str(tmp_path) in _command(place)
    }
    launcher.terminate()
    launcher.wait(timeout=30)
    assert len(groups) == 2
    assert ours in groups


def _command(place: Path) -> str:
    try:
        return (place / "cmdline").read_text()
    except OSError:
        return ""
