"""What a solve ends with, whatever its phases have left."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from diffstack_mmv.control import Batched
from diffstack_mmv.control.constrained import ConstrainedILQR, Inequality, Slack
from diffstack_mmv.control.constrained.conclusion import Conclusion, conclude
from diffstack_mmv.control.constrained.local import Problem
from diffstack_mmv.control.constrained.progress import begin, judge
from diffstack_mmv.control.constrained.solution import ConstrainedSolution
from diffstack_mmv.types import SolverStatus
from tests.control.constrained.test_progress import cart, carts, reach

pytestmark = pytest.mark.usefixtures("double")
CONVERGED, LOST = int(SolverStatus.CONVERGED), int(SolverStatus.NOT_FINITE)


def concluded(problem: Problem, controls: Tensor, *status: int) -> Conclusion:
    """The end of problems that were left with these controls and statuses."""
    left = torch.tensor(status or [CONVERGED] * len(controls))
    return conclude(problem, begin(problem, controls)._replace(status=left), exact=False)


def told(problem: Problem, controls: Tensor, *status: int) -> ConstrainedSolution:
    """The same as a result."""
    return concluded(problem, controls, *status).solution(problem.rows.widths, None)


def over(states: Tensor, controls: Tensor) -> Tensor:
    """A cost that is infinite at the start of the first of two carts, which stand at 0 and 1."""
    return 1 / states[..., 0]


def beyond(states: Tensor, controls: Tensor) -> Tensor:
    """Where the place is past 2."""
    return states[..., :1] - 2


def steep(states: Tensor, controls: Tensor) -> Tensor:
    """A cost that is finite, but infinitely steep in the control of the first cart."""
    return (controls[..., 0] + states[..., 0]).sqrt()


def flung(state: Tensor, force: Tensor) -> Tensor:
    """A cart of which only the speed leaves the numbers, where it stands at 0."""
    after = cart(state, force)
    return torch.stack([after[..., 0].detach(), after[..., 1] / state[..., 0].detach()], -1)


@pytest.mark.parametrize(
    ("part", "function"),
    [("cost", over), ("cost", steep), ("dynamics", flung)],
    ids=["cost", "slope", "motion"],
)
def test_an_end_that_is_not_finite_is_no_solution_and_no_nan(
    part: str, function: Callable[..., Tensor]
) -> None:
    problem, controls = carts([0.0, 1.0])
    found = told(problem._replace(**{part: Batched(function)}), controls)
    assert found.status.tolist() == [LOST, CONVERGED]
    assert not any(each.isnan().any() for each in (*found[:-1], *found.multipliers))
    assert not found[2][1:].isinf().any()


def test_an_infinite_violation_and_an_infinite_cost_are_told_as_such() -> None:
    problem, controls = carts([0.0, torch.inf])
    found = told(problem, controls)
    assert found.status.tolist() == [CONVERGED, LOST]
    assert found.violation.tolist() == [0, torch.inf]
    assert found.cost.isinf().tolist() == [False, True]


@pytest.mark.parametrize("status", [SolverStatus.INFEASIBLE, SolverStatus.ITERATION_LIMIT])
def test_a_problem_that_did_not_converge_keeps_its_status_and_has_no_gradient(
    status: SolverStatus,
) -> None:
    problem, controls = carts([0.0, 1.0])
    found = concluded(problem._replace(cost=Batched(over)), controls, int(status), CONVERGED)
    assert found.parts[5].tolist() == [int(status), CONVERGED]
    assert found.point.valid.tolist() == [False, True]


@pytest.mark.parametrize(("force", "held"), [(20.0, 9.0), (-20.0, -9.0), (torch.nan, 0.0)])
def test_the_controls_at_the_end_are_numbers_within_the_box(force: float, held: float) -> None:
    problem, controls = carts([0.0])
    found = told(problem, torch.full_like(controls, force))
    assert (found.controls == held).all()
    torch.testing.assert_close(found.states, problem.rollout(found.controls))


@pytest.mark.parametrize(("goal", "left"), [(20.0, 0.0), (3.0, 12.0), (-20.0, 18.0)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_residual_is_what_a_step_down_the_slope_moves_in_the_box(
    goal: float, left: float, side: float
) -> None:
    problem, controls = carts([0.0])
    wanted = Batched(lambda x, u: (u[..., 0] - side * goal).square() + 0 * x[..., 0])
    found = told(problem._replace(cost=wanted), torch.full_like(controls, side * 9.0))
    assert float(found.residual) == pytest.approx(left)


@pytest.mark.parametrize("price", [torch.inf, 4.0], ids=["hard", "at a price"])
@pytest.mark.parametrize("place", [0.0, 2.5])
def test_cost_and_violation_are_those_that_its_phases_are_judged_by(
    place: float, price: float
) -> None:
    """Whatever multipliers say of a row, as those of a problem that is not solved may do."""
    problem, controls = carts([place], price)
    found = told(problem, controls, int(SolverStatus.ITERATION_LIMIT))
    torch.testing.assert_close((found.violation, found.cost), tuple(judge(problem, controls)))


@pytest.mark.parametrize("most", [1, 3])
def test_a_price_is_in_the_cost_of_what_too_few_iterations_end_with(most: int) -> None:
    problem, controls = carts([2.5, 0.0], 50.0)
    limit = Inequality(Batched(beyond), Slack(50.0), slice(1, None))
    given = problem.dynamics, problem.cost, [limit], problem.bounds, problem.state
    found = ConstrainedILQR(max_iterations=most)(*given, controls)
    acting = torch.nn.functional.pad(found.controls, (0, 0, 0, 1))
    paid = 50 * beyond(found.states, acting)[:, 1:].clamp_min(0).sum((-2, -1))
    assert not found.converged[0]
    torch.testing.assert_close(found.cost, reach(found.states, acting).sum(-1) + paid)
