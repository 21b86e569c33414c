"""Step sizes: they end inside of all bounds, and at no point that was as good before."""

import pytest
import torch

from diffstack_mmv.control.constrained.barrier import Interior
from diffstack_mmv.control.constrained.filter import Visited, longest, search
from diffstack_mmv.control.constrained.interior import enter
from tests.control.constrained.test_progress import carts

pytestmark = pytest.mark.usefixtures("double")
LEFT = 0.01  # share of the way to a bound that is left


@pytest.mark.parametrize(
    "moved",
    [Interior._fields, *((name,) for name in Interior._fields)],
    ids=["all", *Interior._fields],
)
@pytest.mark.parametrize("size", [1e-3, 0.1, 100.0])
@pytest.mark.parametrize("price", [torch.inf, 4.0], ids=["hard", "at a price"])
def test_the_longest_step_leaves_one_percent_of_the_way_to_the_nearest_bound(size, price, moved):
    problem, controls = carts([0.0, 1.0, 2.5], price)
    barrier, central = enter(problem, controls)
    point = central.point
    sizes = (size if name in moved else 0.0 for name in Interior._fields)
    pairs = zip(point, sizes, strict=True)
    step = Interior(*(each * torch.randn_like(part) for part, each in pairs))
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


def tried(push, defect=0.0, more=0.0, which=True):
    """A step of all forces by a push, from states that are off by a defect, to such that are not.

    With `more` the states are off by that much afterwards.
    """
    problem, controls = carts([0.0, 0.5])
    barrier, central = enter(problem, controls)
    start = central.point._replace(x=central.point.x + defect * torch.arange(11)[:, None])
    start = start._replace(s=start.s - barrier.residual(start).unequal)
    still = Interior(*(torch.zeros_like(part) for part in start))
    u = start.u + push
    x = problem.rollout(u) + more * torch.arange(11)[:, None]
    nearer = torch.where(barrier.rows.applies, x[..., :1] - start.x[..., :1], 0.0)
    step = still._replace(u=u - start.u, x=x - start.x, s=-nearer)
    visited = Visited(torch.zeros(0, 2), torch.zeros(0, 2))
    mask, mu = torch.full((2,), which), torch.full((2,), 0.1)
    residual = barrier.residual(start)
    found = search(barrier, visited, start, step, residual, mu, mask)
    same = torch.equal(found.point.u, start.u) and torch.equal(found.point.x, start.x)
    assert found.taken.unique().numel() == 1
    assert bool(found.taken[0]) is not same
    torch.testing.assert_close(found.violation, residual.total)
    return bool(found.taken[0])


@pytest.mark.parametrize(
    ("step", "taken"),
    [
        ({"push": 0.5}, True),  # forward, where the goal is
        ({"push": -0.5}, False),
        ({"push": 0.5, "which": False}, False),
        ({"push": -0.5, "defect": -0.01}, True),  # back, but to states that can be driven
        ({"push": -0.5, "defect": -0.01, "more": -0.02}, False),
        ({"push": 0.5, "defect": -0.01, "more": -0.02}, True),  # less so, but further
        ({"push": 0.5, "more": -0.001}, False),  # what can be driven is not given up
    ],
)
def test_a_step_is_taken_that_lowers_the_violation_or_the_objective(step, taken):
    assert tried(**step) is taken
