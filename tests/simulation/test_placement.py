"""Rejection in blocks against a loop over single draws."""

import numpy as np
import pytest

from diffstack_mmv.simulation.placement import DOUBTFUL, first_accepted


def one_by_one(random, numbers, accepted, most):
    for _ in range(most):
        draw = random.random_sample(numbers)
        if accepted(draw[None]).any():
            return draw
    return None


@pytest.mark.parametrize("share", [0.9, 0.02, 0.001])
@pytest.mark.parametrize("seed", range(5))
def test_blocks_find_the_same_draw_and_leave_the_same_generator(seed, share):
    randoms = [np.random.RandomState(seed) for _ in range(2)]
    found, expected = (
        search(random, 3, lambda draws: draws[:, 1] < share, 5000)
        for search, random in zip((first_accepted, one_by_one), randoms, strict=True)
    )
    assert (found == expected).all()
    assert randoms[0].random_sample() == randoms[1].random_sample()


def test_no_more_than_the_allowed_draws_are_tried():
    tried = []

    def refused(draws):
        tried.append(len(draws))
        return np.zeros(len(draws), dtype=bool)

    assert first_accepted(np.random.RandomState(0), 2, refused, 1000) is None
    assert sum(tried) == 1000


@pytest.mark.parametrize("possible", [False, True])
def test_whether_any_draw_can_be_accepted_is_asked_once_and_late(possible):
    tried, asked = [], []

    def refused(draws):
        tried.append(len(draws))
        return np.zeros(len(draws), dtype=bool)

    def answer():
        asked.append(sum(tried))
        return possible

    most = 5 * DOUBTFUL
    assert first_accepted(np.random.RandomState(0), 2, refused, most, answer) is None
    assert len(asked) == 1
    assert DOUBTFUL <= asked[0] < 3 * DOUBTFUL
    assert sum(tried) == (most if possible else asked[0])
