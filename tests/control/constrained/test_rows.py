"""Rows of constraints: where they hold, what their violation costs, and how they press."""

import pytest
import torch

from diffstack_mmv.control import Batched
from diffstack_mmv.control.constrained import HARD, Equality, Inequality, Slack
from diffstack_mmv.control.constrained.activity import classify
from diffstack_mmv.control.constrained.barrier_rows import barrier_rows
from diffstack_mmv.control.constrained.constraint import gather

LATER = slice(1, None)


def place(states, controls):
    return states[..., :1]


def speed(states, controls):
    return states[..., 1:]


def rows_of(*constraints, batch=1):
    """Rows of constraints on a place and a speed at the times 0, 1 and 2."""
    return gather(constraints, torch.zeros(batch, 3, 2), torch.zeros(batch, 2, 1))


def test_constraints_stand_side_by_side_and_are_zero_where_they_do_not_hold():
    rows = rows_of(Inequality(place, times=LATER), Equality(speed), Inequality(place, Slack(2.0)))
    states = torch.tensor([[[5.0, 6.0], [7.0, 8.0], [9.0, 10.0]]])
    found = rows.values(states, torch.zeros(1, 3, 1))
    assert found.tolist() == [[[0.0, 6.0, 5.0], [7.0, 8.0, 7.0], [9.0, 10.0, 9.0]]]
    assert rows.signed_functions == [False, True, False]
    assert rows.widths == (1, 1, 1)


@pytest.mark.parametrize(
    ("values", "worst"),
    [
        ([[9.0, 0.0, 9.0], [0.3, 0.1, 9.0], [0.2, 0.0, 9.0]], 0.3),  # not at the start
        ([[0.0, 0.0, 9.0], [-4.0, -0.6, 9.0], [0.2, 0.5, 9.0]], 0.6),  # an equality in both ways
        ([[0.0, 0.0, 9.0], [-4.0, 0.0, 9.0], [-1.0, 0.0, 9.0]], 0.0),  # a price is no violation
    ],
)
def test_the_violation_is_the_largest_of_hard_rows_where_they_hold(values, worst):
    rows = rows_of(Inequality(place, times=LATER), Equality(speed), Inequality(place, Slack(2.0)))
    assert rows.violation(torch.tensor([values])).tolist() == pytest.approx([worst])


def test_soft_rows_pay_for_their_violation_in_proportion_and_by_its_square():
    rows = rows_of(Inequality(place), Inequality(speed, Slack(2.0, 6.0), LATER))
    slack = torch.tensor([[[1.0, 7.0], [1.0, 0.5], [1.0, 1.0]]])
    assert rows.paid(slack).tolist() == pytest.approx([2 * 1.5 + 3 * (0.25 + 1)])


def test_a_price_of_each_problem_stays_with_it():
    price = torch.tensor([1.0, 2.0, 3.0])[:, None, None]
    rows = rows_of(Inequality(Batched(place), Slack(price, 2 * price)), batch=3)
    some = rows.select(torch.tensor([2, 0]))
    assert some.linear[:, 0, 0].tolist() == [3.0, 1.0]
    assert some.quadratic[:, 2, 0].tolist() == [6.0, 2.0]
    assert some.linear.shape == (2, 3, 1)


def test_a_soft_equality_is_two_inequalities_and_a_hard_one_stays_what_it_is():
    found = barrier_rows(rows_of(Inequality(place), Equality(speed), Equality(place, Slack(0.5))))
    values, both = torch.tensor([2.0, 3.0, 5.0]).expand(1, 3, 3), torch.tensor([1.0, 7.0, 4.0])
    assert found.inequalities(values)[0, 0].tolist() == [2.0, 5.0, -5.0]
    assert values[..., found.equality][0, 0].tolist() == [3.0]
    assert found.soft[0, 0].tolist() == [False, True, True]
    assert found.linear[0, 0].tolist() == [0.0, 0.5, 0.5]
    pressing = found.multipliers(both.expand(1, 3, 3), torch.full((1, 3, 1), -6.0), 3)
    assert pressing[0, 0].tolist() == [1.0, -6.0, 7.0 - 4.0]


def test_a_violation_without_a_price_and_times_without_a_constraint_are_left_out():
    found = barrier_rows(rows_of(Inequality(place, Slack()), Inequality(speed, times=LATER)))
    assert found.applies[0].tolist() == [[False, False], [False, True], [False, True]]


@pytest.mark.parametrize(
    ("which", "prices", "told"),
    [
        ("linear", [1.0, -1.0, 1.0], "`.*slack.linear` must be zero or positive"),
        ("quadratic", [1.0, 0.0, -1.0], "`.*slack.quadratic` must be zero or positive"),
        ("quadratic", [1.0, torch.inf, 1.0], "`.*slack.quadratic` must be finite"),
    ],
)
def test_one_price_among_many_that_is_none_is_refused(which, prices, told):
    slack = Slack(**{which: torch.tensor(prices)[:, None, None]})
    with pytest.raises(ValueError, match=told):
        rows_of(Inequality(place, slack), batch=3)


FREE, HOLDS, PAYS, YIELDS = (0, 0), (1, 0), (0, 1), (1, 0)


@pytest.mark.parametrize(
    ("kind", "slack", "raw", "how", "side"),
    [
        (Inequality, HARD, -0.1, FREE, 0),
        (Inequality, HARD, 0.0, FREE, 0),  # reached without a multiplier
        (Equality, HARD, 0.0, HOLDS, 0),
        (Inequality, HARD, 9.0, HOLDS, 0),
        (Equality, HARD, -9.0, HOLDS, 0),
        (Inequality, Slack(0.5), -0.7, FREE, 0),
        (Inequality, Slack(0.5), 0.4, HOLDS, 0),
        (Inequality, Slack(0.5), 0.7, PAYS, 1),
        (Equality, Slack(0.5), -0.4, HOLDS, 0),
        (Equality, Slack(0.5), -0.7, PAYS, -1),
        (Inequality, Slack(0.5, 2.0), 0.4, HOLDS, 0),
        (Inequality, Slack(0.5, 2.0), 0.7, YIELDS, 1),
        (Inequality, Slack(0.5, 2.0), -0.7, FREE, 0),
        (Equality, Slack(0.5, 2.0), -0.7, YIELDS, -1),
        (Inequality, Slack(quadratic=2.0), 0.1, YIELDS, 1),
    ],
)
def test_a_row_is_free_holds_yields_or_presses_with_its_price(kind, slack, raw, how, side):
    found = classify(torch.full((1, 3, 1), raw), rows_of(kind(place, slack, LATER)))
    assert (found.active.tolist()[0], found.saturated.tolist()[0]) == (
        [[False], [bool(how[0])], [bool(how[0])]],
        [[False], [bool(how[1])], [bool(how[1])]],
    )
    assert found.side[0, 1:, 0].tolist() == [side] * 2
    # it is at rest with the multiplier that the price of its violation asks for
    violation = torch.full((1, 3, 1), 0.3 * side)
    asked = side * (slack.linear + slack.quadratic * 0.3) if side else raw
    pressing = found.multipliers(torch.full((1, 3, 1), float(asked)))
    assert pressing[0, 1:, 0].tolist() == pytest.approx([asked if any(how) else 0.0] * 2)
    assert found.residual(violation, pressing).abs().max() < 1e-6
