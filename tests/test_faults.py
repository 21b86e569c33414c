"""The command that tries faults: it tries enough of them, and tells good from bad."""

import pytest

from benchmarks.faults import caches, interruptions, replays, results_files
from benchmarks.faults.__main__ import SOURCES, table
from benchmarks.faults.trial import Result, Told, Trial, attempt

# these make a cache, a stack or its evaluation before they can tell what they try
MADE = (caches, replays, results_files)


@pytest.mark.parametrize(
    "sources",
    [
        [source for source in SOURCES if source not in MADE],
        pytest.param(MADE, marks=pytest.mark.slow),
    ],
)
def test_at_least_250_faults_of_distinct_names_are_tried(sources):
    trials = [trial for source in sources for trial in source.trials()]
    assert len({(trial.kind, trial.name) for trial in trials}) == len(trials) >= 250


@pytest.mark.parametrize(
    ("error", "result"),
    [
        (ValueError("`x` must be positive"), Result.REFUSED),
        (ValueError(), Result.TRACEBACK),
        (ZeroDivisionError("a bug"), Result.TRACEBACK),
    ],
)
def test_an_error_is_a_message_only_where_a_command_tells_it_as_one(error, result):
    def fail(folder):
        raise error

    assert attempt(Trial("kind", "name", fail)).result is result


def test_the_table_counts_by_kind():
    told = [Told(Trial("a", str(n), None), Result.REFUSED, "") for n in range(3)]
    assert "| a | 3 | 3 | 0 | 0 | 0 | 0 | 0 |" in table(told)


@pytest.mark.parametrize("number", [0, 8])
def test_a_conversion_is_killed_where_its_trial_says(number):
    kills = [each for each in interruptions.trials() if each.kind == "kills while converting"]
    assert attempt(kills[number]).result is Result.HELD
