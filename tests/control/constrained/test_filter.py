"""Step sizes: they end inside of all bounds, and at no point that was as good before."""

import pytest
import torch

from diffstack_mmv.control.constrained.barrier import Interior
from diffstack_mmv.control.constrained.filter import Visited, longest
from diffstack_mmv.control.constrained.interior import enter
from tests.control.constrained.test_progress import carts

pytestmark = pytest.mark.usefixtures("double")
LEFT = 0.01  # share of the way to a bound that is left


@pytest.mark.parametrize("size", [1e-3, 0.1, 10.0])
@pytest.mark.parametrize("price", [torch.inf, 4.0], ids=["hard", "at a price"])
def test_the_longest_step_leaves_one_percent_of_the_way_to_the_nearest_bound(size, price):
    problem, controls = carts([0.0, 1.0, 2.5], price)
    barrier, central = enter(problem, controls)
    point = central.point
    step = Interior(*(size * torch.randn_like(part) for part in point))
    sizes = longest(barrier, point, step)
    after = point.moved(step, *sizes)

    def distances(at):
        sigma, spare = (
            torch.where(barrier.yields, part, torch.inf) for part in (at.sigma, barrier.spare(at))
        )
        primal = *barrier.gaps(at.u), at.s, sigma
        dual = at.lower, at.upper, torch.where(barrier.rows.applies, at.z, torch.inf), spare
        return primal, dual

    for taken, parts, ends in zip(sizes, distances(point), distances(after), strict=True):
        pairs = zip(parts, ends, strict=True)
        share = torch.cat([(end / part).flatten(1).nan_to_num(1.0) for part, end in pairs], 1)
        nearest = share.amin(1)
        assert (nearest > LEFT - 1e-9).all()
        assert ((taken == 1) | ((nearest - LEFT).abs() < 1e-9)).all()


@pytest.mark.parametrize(
    ("violation", "objective", "beats"),
    [
        (0.9, 9.0, True),  # less violation than either
        (1.5, 4.0, True),  # a lower objective than the first, less violation than the second
        (3.0, 2.0, True),
        (1.5, 6.0, False),  # the first is better in both
        (3.0, 4.0, False),
        (1.0, 5.0, False),  # it is the first
    ],
)
def test_a_point_has_to_be_better_than_every_earlier_one_in_violation_or_objective(
    violation, objective, beats
):
    visited = Visited(torch.tensor([[1.0], [2.0]]), torch.tensor([[5.0], [3.0]]))
    pair = torch.tensor([violation]), torch.tensor([objective])
    assert bool(visited.beaten_by(*pair)) is beats


def test_a_point_that_was_forgotten_is_beaten_by_all():
    visited = Visited(torch.full((1, 1), torch.inf), torch.zeros(1, 1))
    assert bool(visited.beaten_by(torch.ones(1), torch.ones(1)))
