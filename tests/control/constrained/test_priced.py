"""What a row presses with at a price: the cheapest slack, as a search over all of them finds it."""

import pytest
import torch

from diffstack_mmv.control import Batched, Bounds
from diffstack_mmv.control.constrained import HARD, Equality, Inequality, Slack
from diffstack_mmv.control.constrained.constraint import gather
from diffstack_mmv.control.constrained.local import Problem
from diffstack_mmv.control.constrained.priced import priced_cost, yielding

pytestmark = pytest.mark.usefixtures("double")
PENALTY = 3.0
PLACES = torch.linspace(-2, 2, 41)
SLACKS = [HARD, Slack(0.5), Slack(0.5, 2.0), Slack(quadratic=2.0)]


def priced(kind, slack, multiplier):
    """Problems of one row, whose value is the state, at all places; and the multiplier before."""
    state = PLACES.double()[:, None]
    row = kind(Batched(lambda x, u: x[..., :1]), slack, slice(-1, None))
    rows = gather([row], state[:, None].expand(-1, 2, -1), torch.zeros(41, 1, 1))
    box = Bounds(-torch.ones(1), torch.ones(1))
    free = Batched(lambda x, u: 0 * x[..., 0])
    problem = Problem(Batched(lambda x, u: x), free, rows, box, state)
    return problem, torch.where(rows.applies, multiplier, 0.0).expand(41, 2, 1)


def cheapest(kind, slack, multiplier, value):
    """Price and slack of (ν² - ν₀²) / 2ρ + w₁ s + ½ w₂ s², ν = ν₀ + ρ (g - s) of its sign."""
    both = kind is Equality
    s = torch.zeros(1) if slack is HARD else torch.linspace(-3 if both else 0, 3, 60001)
    after = multiplier + PENALTY * (value - s)
    after = after if both else after.clamp_min(0)
    price = (after.square() - multiplier**2) / (2 * PENALTY)
    if slack is not HARD:
        price = price + slack.linear * s.abs() + 0.5 * slack.quadratic * s.square()
    best = int(price.argmin())
    return float(price[best]), float(s[best].abs()), float(after[best])


@pytest.mark.parametrize("kind", [Inequality, Equality])
@pytest.mark.parametrize("slack", SLACKS, ids=["hard", "linear", "both", "quadratic"])
@pytest.mark.parametrize("multiplier", [0.0, 0.4])
def test_a_row_gives_way_as_far_as_is_cheapest(kind, slack, multiplier):
    problem, before = priced(kind, slack, multiplier)
    penalty = torch.full((41, 1, 1), PENALTY)
    states, controls = problem.state[:, None].expand(-1, 2, -1), torch.zeros(41, 2, 1)
    values = problem.rows.values(states, controls)
    found = yielding(before + penalty * values, penalty, problem.rows)
    paid = priced_cost(problem, before, penalty)(states, controls)[:, -1]
    expected = torch.tensor([cheapest(kind, slack, multiplier, each) for each in PLACES])
    told = torch.stack([paid, found.slack[:, -1, 0], found.multipliers[:, -1, 0]], -1)
    torch.testing.assert_close(told, expected, rtol=0, atol=1e-3)


def test_cost_and_rows_keep_their_own_tensors_and_go_with_their_problems():
    """Two of the cost, one of the first row, none of the second."""
    count, index = 5, torch.tensor([4, 1])
    near, far, limit = torch.rand(3, count)
    states, controls = torch.randn(count, 3, 2), torch.randn(count, 3, 1)
    cost = Batched(lambda x, u, a, b: a[:, None] * x[..., 0] + b[:, None] * u[..., 0], near, far)
    first = Inequality(Batched(lambda x, u, c: x[..., :1] - c[:, None, None], limit), Slack(0.5))
    second = Equality(Batched(lambda x, u: x[..., 1:]))
    enclosed = Inequality(Batched(lambda x, u: x[..., :1] - limit[:, None, None]), Slack(0.5))
    box, weight = Bounds(-torch.ones(1), torch.ones(1)), torch.full((count, 1, 1), PENALTY)

    def priced_with(*rows):
        gathered = gather(rows, states, controls[:, :-1])
        problem = Problem(Batched(lambda x, u: x), cost, gathered, box, states[:, 0])
        return priced_cost(problem, torch.zeros_like(gathered.linear), weight)

    both, bare = priced_with(first, second), cost(states, controls)
    alone = sum(priced_with(row)(states, controls) - bare for row in (enclosed, second))
    whole = both(states, controls)
    torch.testing.assert_close(whole, bare + alone)
    some = both.select(index)(states[index], controls[index])
    torch.testing.assert_close(some, whole[index])
    assert len(both.tensors) == 4 + 3
