"""How much other work a measurement ran beside."""

import os
import threading
from pathlib import Path

BUSY = 1.5  # processes that want to run, the measured one included, above which times are disturbed
EVERY_S = 1.0


class Load:
    """Counts the processes that want to run while its block runs.

    Attributes:
        mean: Their mean number; of one look where the block was shorter than a second.
    """

    def __enter__(self):
        self._seen, self._stop, self.mean = [], threading.Event(), 0.0
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()
        return self

    def __exit__(self, *error):
        self._stop.set()
        self._watcher.join()
        seen = self._seen or [running()]
        self.mean = sum(seen) / len(seen)

    def _watch(self):
        while not self._stop.wait(EVERY_S):
            self._seen.append(running())


def running():
    """Processes that run or wait for a core now, without the one that looks."""
    return float(Path("/proc/loadavg").read_text().split()[3].split("/")[0]) - 1


def remark(mean):
    """The last line of a table."""
    disturbed = (
        " **Measured under load:** other work has disturbed the times." if mean > BUSY else ""
    )
    return (
        f"\nProcesses that ran meanwhile, mean: {mean:.1f} on {os.cpu_count()} cores.{disturbed}\n"
    )
