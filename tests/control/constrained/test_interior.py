"""Where the interior-point method begins, and what it measures there."""

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from diffstack_mmv.control import Batched, Bounds
from diffstack_mmv.control.constrained import HARD, Inequality, Slack
from diffstack_mmv.control.constrained.barrier import Barrier
from diffstack_mmv.control.constrained.constraint import gather
from diffstack_mmv.control.constrained.interior import FIRST, STEEPEST, Central, enter, follow
from diffstack_mmv.control.constrained.local import Problem
from tests.control.constrained.test_progress import cart, carts, reach

pytestmark = pytest.mark.usefixtures("double")
LATER = slice(1, None)
PLACES = torch.tensor([0.0, 1.0, 2.5])  # of carts that may go to 2
PUSH = 9.0
each_price = pytest.mark.parametrize(
    "slack",
    [HARD, Slack(4.0), Slack(0.5, 2.0), Slack(quadratic=2.0)],
    ids=["hard", "linear", "both", "quadratic"],
)


def begun(slack, low=-1.0, high=1.0):
    """Carts that are pushed as hard as can be, beside a wall that a price may open."""
    state = torch.stack([PLACES.double(), torch.zeros(3)], -1)
    rows = gather(
        [Inequality(lambda x, u: x[..., :1] - 2, slack, LATER)],
        state.unsqueeze(-2).expand(-1, 5, -1),
        torch.zeros(3, 4, 1),
    )
    box = Bounds(torch.tensor([low]), torch.tensor([high]))
    problem = Problem(Batched(cart), Batched(reach), rows, box, state)
    return enter(problem, torch.full((3, 4, 1), PUSH))


@each_price
def test_it_begins_inside_of_all_bounds_on_a_motion_that_can_be_driven(slack):
    barrier, central = begun(slack)
    point, applies = central.point, barrier.rows.applies
    assert central.started.all()
    assert (point.u < 1).all()
    assert (point.u > 0.9).all()
    assert (point.s > 0).all()
    assert (point.z > 0)[applies].all()
    assert (point.z == 0)[~applies].all()
    assert (barrier.spare(point) > 0).all()
    for gap, pressure in zip(barrier.gaps(point.u), (point.lower, point.upper), strict=True):
        torch.testing.assert_close(gap * pressure, torch.full_like(gap, FIRST))
    residual = barrier.residual(point)
    assert residual.defect.abs().max() < 1e-12
    met = PLACES.double() < 2
    assert residual.total[met].max() < 0.1


@each_price
def test_a_first_violation_is_one_that_its_price_asks_for(slack):
    barrier, central = begun(slack)
    sigma = central.point.sigma[0, 1:, 0]  # of the cart that is far from the wall
    if slack is HARD:
        assert (sigma == 0).all()
        return
    price = barrier.scale[0] * (slack.linear + slack.quadratic * sigma)
    assert ((sigma * price - FIRST).abs() < 1e-9).logical_or(sigma == 0.01).all()


@each_price
def test_the_objective_is_the_scaled_cost_with_prices_and_logarithms_of_all_distances(slack):
    barrier, central = begun(slack)
    point, mu = central.point, torch.tensor([0.1, 0.2, 0.3])
    found = barrier.objective(point, mu)
    for number in range(3):
        x, u = point.x[number], point.u[number, :, 0]
        cost = sum((float(place) - 3) ** 2 for place in x[:, 0])
        cost += 0.01 * sum(float(force) ** 2 for force in u)
        logs = sum(math.log(1 - float(force)) + math.log(1 + float(force)) for force in u)
        for time in range(1, 5):
            logs += math.log(float(point.s[number, time, 0]))
            if slack is not HARD:
                sigma = float(point.sigma[number, time, 0])
                cost += slack.linear * sigma + 0.5 * slack.quadratic * sigma**2
                logs += math.log(sigma)
        expected = float(barrier.scale[number]) * cost - float(mu[number]) * logs
        assert float(found[number]) == pytest.approx(expected)


def test_a_side_without_a_bound_and_a_control_that_is_fixed_have_no_distance():
    barrier, central = begun(HARD, high=torch.inf)
    below, above = barrier.gaps(central.point.u)
    assert below.isfinite().all()
    assert above.isinf().all()
    barrier, central = begun(HARD, low=0.5, high=0.5)
    assert all(gap.isinf().all() for gap in barrier.gaps(central.point.u))
    assert (central.point.u == 0.5).all()


def entered(cost: Callable[..., Tensor], speed: float = 0.0) -> tuple[Barrier, Central]:
    """Where it begins with the two carts at 0 and 1, at a speed and a cost of one's own."""
    problem, controls = carts([0.0, 1.0])
    state = problem.state + torch.tensor([0.0, speed])
    return enter(problem._replace(cost=Batched(cost), state=state), controls)


@pytest.mark.parametrize("unit", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize(
    "slope", [lambda x, u: -x[..., 1] + 0 * u[..., 0], lambda x, u: 3 * u[..., 0] + 0 * x[..., 0]]
)
def test_the_unit_of_the_cost_is_taken_out_by_its_steepest_slope(
    slope: Callable[..., Tensor], unit: float
) -> None:
    steepest = abs(float(slope(torch.ones(1, 2), torch.ones(1, 1))))
    barrier, _ = entered(lambda x, u: unit * slope(x, u))
    torch.testing.assert_close(barrier.scale * unit * steepest, torch.full((2,), STEEPEST))


@pytest.mark.parametrize(
    "cost",
    [lambda x, u: x[..., 0].sqrt(), lambda x, u: torch.nan * x[..., 0]],
    ids=["infinitely steep", "no number"],
)
def test_it_does_not_begin_where_a_cost_has_no_finite_slope(cost: Callable[..., Tensor]) -> None:
    _, central = entered(cost)
    assert not central.started[0]
    assert not central.open[0]


@pytest.mark.parametrize("speed", [torch.nan, torch.inf])
def test_it_does_not_begin_on_a_motion_that_is_not_finite(speed: float) -> None:
    _, central = entered(lambda x, u: u[..., 0].square() + 0 * x[..., 0].detach(), speed)
    assert not central.started.any()


@each_price
def test_it_begins_on_the_central_path_of_its_first_barrier(slack) -> None:
    barrier, central = begun(slack)
    products = (central.point.s * central.point.z)[barrier.rows.applies]
    assert (products <= FIRST + 1e-12).all()  # less where the price bounds the multiplier
    assert slack is not HARD or (products >= FIRST - 1e-12).all()
    assert (central.point.y == 0).all()


def test_problems_that_go_on_alone_return_to_their_place():
    problem, controls = carts([0.0, 1.9, 1.9, 1.9, -3.0, 1.9, 1.9, 1.9, 0.5])
    everywhere = torch.ones(9, dtype=torch.bool)
    together = follow(problem, controls, 100, everywhere)
    assert together.solved.all()
    for each in range(9):
        index = torch.tensor([each])
        alone = follow(problem.select(index), controls[index], 100, everywhere[:1])
        whole = (part[index] for part in together)
        for found, expected in zip(whole, alone, strict=True):
            torch.testing.assert_close(found, expected)
    assert (together.iterations == together.iterations[1]).sum() > 5
    assert (together.iterations > together.iterations[1]).any()
    most = int(together.iterations.max()) - 1  # one too few for some
    limited = follow(problem, controls, most, everywhere)
    assert limited.iterations.max() == most
    assert 5 < limited.solved.sum() < 9
