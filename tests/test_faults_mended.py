"""Faults that once passed unseen, lost what was whole, or ended in a traceback."""

from functools import cache

import pytest

from benchmarks.faults import caches, crowds, logs, own_tables, replays, results_files, scales
from benchmarks.faults.trial import Result, attempt

REPORTED, REFUSED = Result.REPORTED, Result.REFUSED
AMONG = "ETH/UCY scenes: one agent among others"
OWN = "tables of one's own"
RIDES, WINDOWS = "rides of a cache", "windows of a cache"
MENDED = [
    # one clock in another year or at minus infinity moved or lost all the others
    (crowds, AMONG, "first sample ten years early", REPORTED),
    (crowds, AMONG, "minus infinite time", REPORTED),
    # what is named like a file and is none ended the conversion
    (crowds, "CITR clips", "a folder", REPORTED),
    (crowds, "SDD videos", "a dangling link", REPORTED),
    (crowds, "DUT clips", "header only", REPORTED),
    (crowds, "SDD videos: one agent among others", "NaN number of the agent", REPORTED),
    # one table unlike the others ended the conversion of all
    (crowds, OWN, "time in ms", REPORTED),
    (crowds, OWN, "millimetres", REPORTED),
    (crowds, OWN, "no column x", REPORTED),
    (own_tables, "Parquet tables", "cut at 50 %", REPORTED),
    (own_tables, "descriptions of tables", "a rate of 0", REFUSED),
    # a scale of one video was taken as it was, or ended the conversion of all
    (scales, "scales of videos", "scale of '-0.04'", REPORTED),
    (scales, "scales of videos", "scale of 'one'", REPORTED),
    (scales, "scales of videos", "ratio of '1e300'", REPORTED),
    (scales, "tables of scales", "other columns, dut", REFUSED),
    # values that no instrument tells stood in the cache unseen
    (logs, "Autobike logs", "1e300 in Steering Angle encoder(rad)", REPORTED),
    (logs, "Autobike logs", "NaN throughout State Estimate Roll (rad)", REPORTED),
    (logs, "Autobike logs", "0 for a second in Lat GPS (deg)", REPORTED),
    (logs, "Autobike logs", "time times 1e300", REPORTED),
    (caches, RIDES, "metadata: lost", REFUSED),
    (caches, RIDES, "rows: cut off", REFUSED),
    (caches, RIDES, "controls: text", REFUSED),
    (caches, RIDES, "sensors with NaN in all values", REFUSED),
    (caches, RIDES, "sensors of another hour", REFUSED),
    (caches, WINDOWS, "metadata: lost", REFUSED),
    (caches, WINDOWS, "metadata: cut off", REFUSED),
    (caches, "exports of a cache", "usable.npy: empty", REFUSED),
    (caches, "exports of a cache", "samples.parquet: cut off", REFUSED),
    # a changed bit was another weight
    (replays, "damage of a whole checkpoint", "load: a byte changed at 50 %", REFUSED),
    (replays, "damage of a whole checkpoint", "resume: a byte changed at 50 %", REFUSED),
    (replays, "replayed checkpoints", "hidden under a class of ours", REFUSED),
    (results_files, "pages of evaluate", "metrics.json: null in everything", REFUSED),
    (results_files, "pages of evaluate", "metrics.json: nested deep", REFUSED),
    (results_files, "comparisons", "samples: cut off", REFUSED),
    (results_files, "earlier drives", "no case in common", REFUSED),
    (results_files, "pages of simulate", "trajectory_kbm.csv: zero bytes", REFUSED),
    (results_files, "recorded controls", "rows with more columns", REFUSED),
]


@cache
def trials_of(module):
    return {(trial.kind, trial.name): trial for trial in module.trials()}


# a stack, its evaluation and a drive are made for these; the parts have quick tests of their own
SLOW = (replays, results_files)
CASES = [
    pytest.param(*each, id=", ".join(each[1:3]), marks=[pytest.mark.slow] * (each[0] in SLOW))
    for each in MENDED
]


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(("module", "kind", "name", "result"), CASES)
def test_a_fault_is_told_and_costs_itself_alone(module, kind, name, result):
    told = attempt(trials_of(module)[kind, name])
    assert told.result is result, told.message
