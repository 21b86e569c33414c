"""The phases of the benchmark: which cases they have, and the random generator of each case."""

from typing import NamedTuple

import numpy as np

from diffstack_mmv.checks import require, require_one_of, require_whole


class Phase(NamedTuple):
    """Numbers of the cases of a phase and where their seeds begin."""

    first_seed: int
    cases: int


PHASES = {
    "train": Phase(2000, 2**32 - 2000),
    "val": Phase(0, 1000),
    "test": Phase(1000, 1000),
}


def generator(phase: str, number: int) -> np.random.RandomState:
    """Random generator of a case, the one of the original benchmark.

    Args:
        phase: "train", "val" or "test".
        number: Which case of the phase, from 0.

    Returns:
        A generator of its own.

    Raises:
        ValueError: There is no such phase or case.
    """
    require_case(phase, number)
    return np.random.RandomState(PHASES[phase].first_seed + number)


def require_case(phase: str, number: int) -> None:
    """Refuse a case that the benchmark does not have.

    Args:
        phase: "train", "val" or "test".
        number: Which case of the phase, from 0.

    Raises:
        ValueError: There is no such phase or case.
    """
    require_one_of("phase", phase, tuple(PHASES))
    require_whole("case", number)
    cases = PHASES[phase].cases
    require(
        0 <= number < cases,
        "case",
        f"lie in [0, {cases - 1}]",
        number,
        f"in phase {phase!r}",
        "Seeds beyond belong to another phase.",
    )
