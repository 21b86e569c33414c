"""Try all faults and print the table: `python -m benchmarks.faults > docs/results/faults.md`."""

import logging
import sys
import time
import warnings
from collections import Counter

from benchmarks.faults import (
    archives,
    caches,
    checkpoints,
    configuration,
    crowds,
    interruptions,
    json_files,
    logs,
    own_tables,
    replays,
    results_files,
    scales,
    solving,
    tables,
)  # fmt: skip
from benchmarks.faults.trial import Result, Told, Trial, attempt

SOURCES = (
    interruptions, tables, json_files, crowds, scales, own_tables, logs, archives, caches,
    checkpoints, replays, results_files, solving, configuration,
)  # fmt: skip
NEVER = (Result.LOST, Result.SILENT, Result.TRACEBACK)


def table(told: list[Told]) -> str:
    """Results by kind as Markdown."""
    lines = [
        "# Faults tried, and what became of them",
        "",
        "`make faults` tries each of these in a folder of its own and writes this table. *No harm done* is a kill after",
        "which the repeated command gives what an uninterrupted one gives, or a number that leaves everything finite. The last",
        "three columns must hold nothing: a track or result that is gone without a word, a fault that is taken for good, an",
        "error that is no message.",
        "",
        "| kind | tried | " + " | ".join(Result) + " |",
        "|---|" + "---|" * (len(Result) + 1),
    ]
    counts = Counter((each.trial.kind, each.result) for each in told)
    for kind in dict.fromkeys(each.trial.kind for each in told):
        row = [counts[kind, result] for result in Result]
        lines.append(f"| {kind} | {sum(row)} | " + " | ".join(map(str, row)) + " |")
    total = [sum(each.result == result for each in told) for result in Result]
    lines.append(f"| **all** | {len(told)} | " + " | ".join(map(str, total)) + " |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Try everything; the status is 1 where anything happened that must not."""
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    begin, told = time.monotonic(), []
    trials: list[Trial] = [trial for source in SOURCES for trial in source.trials()]
    only = sys.argv[1:]
    for trial in trials:
        if not only or any(name in trial.kind for name in only):
            told.append(attempt(trial))
    bad = [each for each in told if each.result in NEVER]
    for each in bad:
        print(
            f"{each.result}: {each.trial.kind}, {each.trial.name}\n{each.message}", file=sys.stderr
        )
    print(table(told), end="")
    print(f"{len(told)} faults in {time.monotonic() - begin:.0f} s", file=sys.stderr)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
