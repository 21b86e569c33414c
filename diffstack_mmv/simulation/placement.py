"""Rejection sampling, many draws at a time, with the stream of one draw after the other."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

FIRST_BLOCK = 4
LARGEST_BLOCK = 2**14
DOUBTFUL = 2**14
"""Draws without success after which it is worth asking whether there can be any."""


def first_accepted(
    random: np.random.RandomState,
    numbers: int,
    accepted: Callable[[Float[np.ndarray, "k n"]], Bool[np.ndarray, " k"]],
    most: int,
    possible: Callable[[], bool] = lambda: True,
) -> Float[np.ndarray, " n"] | None:
    """The first draw that is accepted, as a loop over single draws would find it.

    A full scenario leaves so little room that a newcomer needs millions of draws: they are judged
    in blocks, which grow. The generator is left as the loop would leave it.

    Args:
        random: Generator, which is advanced past the accepted draw.
        numbers: How many uniform numbers in [0, 1) a draw takes.
        accepted: Judges draws.
        most: Largest number of draws.
        possible: Whether any draw can be accepted: asked once, where many were not.

    Returns:
        The uniform numbers of the draw, or None if none of `most` is accepted, or none ever would.
    """
    tried, block, asked = 0, FIRST_BLOCK, False
    while tried < most:
        if tried >= DOUBTFUL and not asked:
            if not possible():
                return None
            asked = True
        block = min(block, most - tried)
        before = random.get_state()
        draws = random.random_sample((block, numbers))
        good = accepted(draws)
        if good.any():
            index = int(good.argmax())
            random.set_state(before)
            random.random_sample((index + 1) * numbers)
            return draws[index]
        tried, block = tried + block, min(2 * block, LARGEST_BLOCK)
    return None
