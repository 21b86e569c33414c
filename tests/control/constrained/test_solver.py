"""Constrained solutions: optimal, within every constraint, and told from what has none."""

import pytest
import torch

from diffstack_mmv.control import ILQR, Batched, Bounds, Constraints, SolverStatus, Unrolled
from diffstack_mmv.control.constrained import (
    HARD,
    ConstrainedILQR,
    Equality,
    Inequality,
    Slack,
    listed,
)
from tests.control.constrained.problems import braking, constraints, drives, solve

pytestmark = pytest.mark.usefixtures("double")
SOLVER = ConstrainedILQR(ILQR())
BOX = Bounds(torch.tensor([-9.0]), torch.tensor([9.0]))


def cart(state, force):
    place, speed = state.unbind(-1)
    return torch.stack([place + 0.1 * speed, speed + 0.1 * force[..., 0]], -1)


def reach(states, forces):
    return (states[..., 0] - 3).square() + 0.01 * forces[..., 0].square()


def wall(states, forces):
    return states[..., :1] - 2


def rest(states, forces):
    return states[..., 1:]


def brought(constraints, box=BOX, batch=3, steps=15, **warm):
    state, guess = torch.zeros(batch, 2), torch.zeros(batch, steps, 1)
    return SOLVER(cart, reach, constraints, box, state, guess, **warm)


def test_without_constraints_it_is_the_plain_solver():
    plain = ILQR()(cart, reach, BOX, torch.zeros(3, 2), torch.zeros(3, 15, 1))
    assert all((a == b).all() for a, b in zip(brought([]).solution, plain, strict=True))


@pytest.mark.parametrize(
    ("record", "held"),
    [
        (Constraints(inequality=wall), [Inequality(wall)]),
        (Constraints(inequality=wall, equality=lambda x, u: 0 * x[..., 1:]), [Inequality(wall)]),
    ],
    ids=["inequality", "and a void equality"],
)
def test_the_plain_solver_takes_constraints_too(record, held):
    problem = BOX, torch.zeros(2, 2), torch.zeros(2, 20, 1)
    found = ILQR()(cart, reach, *problem, constraints=record)
    expected = SOLVER(cart, reach, held, *problem)
    assert found.converged.all()
    assert float(found.violation.max()) < 1e-9
    torch.testing.assert_close(found.controls, expected.controls, atol=1e-7, rtol=0)


def test_constraints_that_nothing_touches_change_nothing():
    plain = ILQR()(cart, reach, BOX, torch.zeros(3, 2), torch.zeros(3, 15, 1))
    far = Inequality(lambda states, forces: states[..., :1] - 100)
    solution = brought([far])
    assert (solution.controls == plain.controls).all()
    assert (solution.multipliers[0] == 0).all()


def backwards(states, forces):
    return -states[..., 1:]


@pytest.mark.parametrize("goal", [3.0, 0.1 + 0.2])
@pytest.mark.parametrize("slack", [HARD, Slack(5.0), Slack(quadratic=2.0)])
@pytest.mark.parametrize("kind", [Inequality, Equality])
def test_a_cart_that_stands_at_its_goal_and_may_not_reverse_stays(kind, slack, goal):
    """There the cost is zero, and rounding alone moves the cart backwards."""
    limits = [kind(backwards, slack), Inequality(lambda x, u: x[..., :1] - goal)]
    start = torch.tensor([[0.3, 0.0]]) if goal < 1 else torch.tensor([[goal, 0.0]])
    wanted = torch.tensor(goal, requires_grad=True)

    def cost(states, forces):
        effort = 0.3 * states[..., 1].square() + 0.01 * forces[..., 0].square()
        return (states[..., 0] - wanted).square() + effort

    found = SOLVER(cart, cost, limits, BOX, start, torch.zeros(1, 10, 1))
    assert found.status.tolist() == [SolverStatus.CONVERGED]
    assert found.controls.abs().max() < 1e-14
    (slope,) = torch.autograd.grad(found.states.sum(), wanted)
    assert slope.isfinite()


@pytest.mark.parametrize("limit", [4.0, 30.0], ids=["reached", "far"])
def test_a_length_of_the_force_limits_it_until_the_end_where_there_is_none(limit):
    """At the end the controls are zero, where a length has no derivative."""

    def cost(states, forces):
        return reach(states, forces) + 0.3 * states[..., 1].square()

    def length(states, forces):
        return torch.hypot(forces, states[..., 1:] * forces) - limit

    def squared(states, forces):
        square = forces.square() * (1 + states[..., 1:].square())
        return square / limit**2 - 1

    given = BOX, torch.zeros(1, 2), torch.full((1, 10, 1), 0.1)
    found, expected = (
        SOLVER(cart, cost, [Inequality(each, times=slice(-1))], *given)
        for each in (length, squared)
    )
    assert found.converged.all()
    torch.testing.assert_close(found.controls, expected.controls)


def test_without_a_second_derivative_a_solution_has_no_gradient_instead_of_nan():
    """The last force moves nothing any more, and is zero: there a length has none."""
    goal = torch.tensor(3.0, requires_grad=True)

    def cost(states, forces):
        return (states[..., 0] - goal).square() + 0.01 * forces[..., 0].square()

    def length(states, forces):
        return torch.cat([forces, forces], -1).norm(dim=-1, keepdim=True) - 30

    limits, box = [Inequality(length, times=slice(-1))], Bounds(-9 * torch.ones(1), torch.ones(1))
    given = cart, cost, limits, box, torch.zeros(1, 2), torch.full((1, 10, 1), 0.1)
    found = SOLVER(*given)
    assert found.status.tolist() == [SolverStatus.NOT_FINITE]
    assert torch.autograd.grad(found.states.sum(), goal)[0] == 0
    with torch.no_grad():
        assert SOLVER(*given).converged.all()


def test_inequality_equality_and_box_hold_together():
    tight = Bounds(torch.tensor([-5.0]), torch.tensor([5.0]))
    solution = brought([Inequality(wall), Equality(rest, times=slice(-1, None))], tight)
    assert solution.converged.all()
    assert solution.states[..., 0].max() < 2 + 1e-12
    assert solution.states[:, -1, 1].abs().max() < 1e-12
    assert (solution.controls == 5).any()
    assert solution.violation.max() < 1e-12
    assert (solution.multipliers[0] >= 0).all()
    assert (solution.multipliers[1][:, :-1] == 0).all()


def test_box_of_zero_width_and_no_box_hold():
    fixed = Bounds(torch.tensor([0.5]), torch.tensor([0.5]))
    assert (brought([Inequality(wall)], fixed).controls == 0.5).all()
    nothing = Bounds(torch.tensor([-torch.inf]), torch.tensor([torch.inf]))
    solution = brought([Inequality(wall)], nothing)
    assert solution.converged.all()
    assert solution.violation.max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Inequality, Equality])
def test_a_price_above_the_multiplier_is_as_good_as_hard(kind):
    end = slice(-1, None)
    hard = brought([kind(wall, times=end)])
    dear = 2 * float(hard.multipliers[0].abs().max())
    soft = brought([kind(wall, Slack(linear=dear), end)])
    torch.testing.assert_close(soft.controls, hard.controls, rtol=0, atol=1e-7)


@pytest.mark.parametrize("kind", [Inequality, Equality])
@pytest.mark.parametrize("slack", [Slack(linear=0.5), Slack(0.5, 3.0), Slack(quadratic=20.0)])
def test_a_low_price_is_paid(kind, slack):
    """The multiplier is the marginal price, and the cost has the price in it."""
    solution = brought([kind(wall, slack, slice(-1, None))])
    excess = solution.states[:, -1, 0] - 2
    padded = torch.cat([solution.controls, torch.zeros(3, 1, 1)], -2)
    bare = reach(solution.states, padded).sum(-1)
    paid = slack.linear * excess + 0.5 * slack.quadratic * excess.square()
    assert solution.converged.all()
    assert (excess > 0.01).all()
    torch.testing.assert_close(
        solution.multipliers[0][:, -1, 0], slack.linear + slack.quadratic * excess
    )
    torch.testing.assert_close(solution.cost, bare + paid)


@pytest.mark.parametrize("price", [1e-3, 0.7, 20.0])
def test_a_price_of_squares_alone_is_a_term_of_the_cost(price):
    torch.manual_seed(4)
    across, gain, goal = 0.3 * torch.randn(3, 3), torch.randn(2, 3), torch.randn(8, 1, 3)
    given = Bounds(-torch.ones(2), torch.ones(2)), 0.3 * torch.randn(8, 3), torch.zeros(8, 4, 2)

    def step(state, control):
        return torch.tanh(state @ across) + control @ gain

    def cost(states, controls):
        return (states - goal).square().sum(-1) + 0.3 * (controls + 0.1).square().sum(-1)

    def beyond(states, controls):
        return states[..., :2] - 0.25

    def priced(states, controls):
        paid = beyond(states, controls).clamp_min(0).square().sum(-1)
        return cost(states, controls) + 0.5 * price * paid

    found = SOLVER(step, cost, [Inequality(beyond, Slack(quadratic=price))], *given)
    assert found.converged.all()
    torch.testing.assert_close(found.cost, ILQR()(step, priced, *given).cost)


def test_contradictory_constraints_are_infeasible():
    solution = brought(
        [Inequality(wall), Inequality(lambda x, u: 2.5 - x[..., :1], times=slice(-1, None))]
    )
    assert (solution.status == SolverStatus.INFEASIBLE).all()
    assert solution.infeasible.all()
    assert solution.violation.min() > 0.1


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_violation_that_no_step_lowers_is_infeasible_in_either_precision(dtype):
    """In float32 rounding alone is more than what counts as feasible."""

    def far(states, forces):
        return 5 - states[..., :1]

    box = Bounds(*(bound.to(dtype) for bound in BOX))
    start, guess = torch.zeros(1, 2, dtype=dtype), torch.zeros(1, 15, 1, dtype=dtype)
    found = SOLVER(cart, reach, [Inequality(far, times=slice(1, None))], box, start, guess)
    assert found.status.tolist() == [SolverStatus.INFEASIBLE]
    assert float(found.violation.max()) == pytest.approx(5.0)


def test_what_the_box_does_not_allow_is_infeasible():
    weak = Bounds(torch.tensor([-0.1]), torch.tensor([0.1]))
    far = Equality(lambda states, forces: states[..., :1] - 2, times=slice(-1, None))
    assert brought([far], weak).infeasible.all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    ("times", "status"),
    [(slice(None), SolverStatus.INFEASIBLE), (slice(1, None), SolverStatus.CONVERGED)],
)
def test_a_state_that_is_given_cannot_be_constrained(times, status, dtype):
    moving = torch.tensor([[1.5, 1.2]], dtype=dtype)

    def limit(states, forces):
        return states[..., 1:] - 1

    still = torch.zeros(1, 9, 1, dtype=dtype)
    box = Bounds(*(bound.to(dtype) for bound in BOX))
    found = SOLVER(cart, reach, [Inequality(limit, times=times)], box, moving, still)
    assert found.status.tolist() == [status]


def test_redundant_constraints_do_no_harm():
    once = brought([Inequality(wall)])
    twice = brought([Inequality(wall), Inequality(wall), Inequality(lambda x, u: 2 * wall(x, u))])
    torch.testing.assert_close(twice.controls, once.controls, rtol=0, atol=1e-7)


def taken(drive, index):
    """Some of the drives."""
    return type(drive)(*(part[index] for part in drive))


@pytest.fixture(scope="module")
def solved():
    """Drives and their solutions."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    drive = drives(6)
    solution = solve(SOLVER, drive, braking(drive))
    torch.set_default_dtype(before)
    return drive, solution


def test_drives_end_within_every_constraint(solved):
    drive, solution = solved
    assert solution.converged.all()
    assert solution.violation.max() <= 1e-9
    assert solution.residual.max() <= 1e-9
    padded = torch.nn.functional.pad(solution.controls, (0, 0, 0, 1))
    for limit, multiplier in zip(constraints(drive), solution.multipliers, strict=True):
        assert (multiplier >= 0).all()
        assert (multiplier > 0).any()
        assert (limit.function(solution.states, padded) * multiplier).abs().max() < 1e-8


def test_answer_is_free_of_the_batch_mates(solved):
    drive, together = solved
    alone = taken(drive, [5])
    single = solve(SOLVER, alone, braking(alone))
    assert single.status == together.status[5]
    torch.testing.assert_close(single.controls[0], together.controls[5], rtol=0, atol=1e-8)


def bare(part):
    """A callable that cannot be selected from."""
    return lambda *arguments: part(*arguments)


def hiding(dynamics, cost, limits, *rest):
    limits = [Inequality(bare(limit.function), limit.slack, limit.times) for limit in limits]
    return SOLVER(bare(dynamics), bare(cost), limits, *rest)


def test_closures_give_the_same_and_nan_of_one_problem_touches_no_other(solved):
    drive, clean = solved
    drive = taken(drive, [0, 1, 2, 3])
    drive.state[2, 0] = torch.nan
    drive.radius[3] = torch.nan
    solution = solve(hiding, drive, braking(drive).nan_to_num(0.0))
    assert solution.status.tolist() == [0, 0, *[SolverStatus.NOT_FINITE] * 2]
    assert all(part.isnan().sum() == 0 for part in (*solution.solution, *solution.multipliers))
    torch.testing.assert_close(solution.controls[:2], clean.controls[:2], rtol=0, atol=1e-8)


def test_a_warm_start_takes_a_few_iterations(solved):
    drive, cold = (taken(part, [1, 2]) for part in (solved[0], solved[1].solution))
    multipliers = [multiplier[[1, 2]] for multiplier in solved[1].multipliers]
    moved = drive._replace(state=drive.state + 1e-5)
    warm = solve(SOLVER, moved, cold.controls, multipliers)
    again = solve(SOLVER, moved, cold.controls)
    assert warm.converged.all()
    assert (warm.iterations < 10).all()
    assert (warm.iterations < again.iterations).all()
    torch.testing.assert_close(warm.controls, again.controls, rtol=0, atol=1e-7)


@pytest.mark.parametrize("batch", [(), (2, 3), (0,)])
def test_any_leading_dimensions(batch):
    solution = SOLVER(
        cart, reach, [Inequality(wall)], BOX, torch.zeros(*batch, 2), torch.zeros(*batch, 15, 1)
    )
    assert solution.states.shape == (*batch, 16, 2)
    assert solution.multipliers[0].shape == (*batch, 16, 1)
    assert solution.converged.shape == batch
    assert solution.converged.all()


def test_single_precision_is_good_to_its_rounding():
    box = Bounds(torch.tensor([-9.0]).float(), torch.tensor([9.0]).float())
    state, guess = torch.zeros(3, 2).float(), torch.zeros(3, 15, 1).float()
    solution = SOLVER(cart, reach, [Inequality(wall)], box, state, guess)
    assert solution.converged.all()
    assert solution.violation.max() < 2e-5
    torch.testing.assert_close(
        solution.states.double(), brought([Inequality(wall)]).states, rtol=0, atol=1e-3
    )


def affine(state, control, A, B):
    return (A @ state.unsqueeze(-1) + B @ control.unsqueeze(-1)).squeeze(-1)


def quadratic(states, controls, hessian, slope):
    both = torch.cat([states, controls], -1)
    return 0.5 * ((both @ hessian) * both).sum(-1) + (both * slope.unsqueeze(-2)).sum(-1)


def linear(states, controls, rows, limit):
    return states @ rows.mT - limit.unsqueeze(-2)


def feasible(count, dtype, steps=15, limit=0.5):
    """Convex problems, unstable dynamics; inside of all limits is at least one drive of each."""
    generator = torch.Generator().manual_seed(0)

    def normal(*shape):
        return torch.randn(count, *shape, generator=generator, dtype=torch.float64)

    A, B, start = torch.eye(2) + 0.2 * normal(2, 2), 0.5 * normal(2, 3), 0.5 * normal(2)
    factor = normal(5, 5)
    hessian, slope = factor @ factor.mT / 5 + 0.1 * torch.eye(5), normal(5)
    drive = limit * torch.tanh(normal(steps, 3))
    states = [start]
    for control in drive.unbind(1):
        states.append(affine(states[-1], control, A, B))
    path, rows, ends = torch.stack(states, 1), normal(3, 2), normal(1, 2)
    top, end = (path @ rows.mT)[:, 1:].amax(1) + 0.05, (path[:, -1:] @ ends.mT).squeeze(1)

    def batched(function, *tensors):
        return Batched(function, *(tensor.to(dtype) for tensor in tensors))

    box = Bounds(torch.full((3,), -limit, dtype=dtype), torch.full((3,), limit, dtype=dtype))
    constraints = [
        Inequality(batched(linear, rows, top), times=slice(1, None)),
        Equality(batched(linear, ends, end), times=slice(-1, None)),
    ]
    callables = batched(affine, A, B), batched(quadratic, hessian, slope), constraints
    return *callables, box, start.to(dtype), torch.zeros(count, steps, 3, dtype=dtype)


@pytest.mark.slow
def test_convex_problems_that_rounding_keeps_from_the_end_of_the_path_are_solved():
    """Where the last μ cannot be reached Newton's method goes on from the one before."""
    with torch.no_grad():
        solution = SOLVER(*feasible(24, torch.float64))
    assert solution.converged.all()
    assert solution.violation.max() < 1e-9


@pytest.mark.slow
def test_single_precision_does_not_call_infeasible_what_it_cannot_resolve():
    """The default precision is double here: no constant of it may get among the numbers."""
    with torch.no_grad():
        solution = SOLVER(*feasible(8, torch.float32))
    assert solution.controls.dtype == torch.float32
    assert not solution.infeasible.any()
    assert solution.violation[solution.converged].max() < 2e-5
    assert solution.converged.any()


def test_too_few_iterations_are_a_status():
    drive = drives(2)
    solution = solve(ConstrainedILQR(max_iterations=2), drive, braking(drive))
    assert (solution.status == SolverStatus.ITERATION_LIMIT).all()


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("limit", "given", "told"),
    [
        (lambda x, u: x[..., 1:, :1], {}, r"constraints\[0\].*must return values of shape"),
        (lambda x, u: u.diff(dim=-2, append=u[..., :1, :]), {}, "depend at each time on state"),
        (lambda x, u: u.diff(dim=-2, prepend=u[..., :1, :]), {}, "depend at each time on state"),
        (lambda x, u: x[..., :1].detach(), {}, "must be differentiable in state or control"),
        (lambda x, u: x[..., :1].float(), {}, "must return torch.float64 as the state"),
        (wall, {"slack": Slack(linear=-1.0)}, r"slack.linear.*must be zero or positive"),
        (wall, {"slack": Slack(torch.tensor([[[2.0]], [[-1.0]], [[2.0]]]))}, r"but got -1\.0\."),
        (wall, {"slack": Slack(quadratic=torch.ones(7, 5))}, r"slack.quadratic.*must broadcast"),
        (wall, {"slack": Slack(quadratic=torch.inf)}, r"slack.quadratic.*must be finite"),
    ],
)
def test_constraints_that_do_not_fit_are_refused(limit, given, told):
    with pytest.raises(ValueError, match=told):
        brought([Inequality(limit, **given)])


def beside_a_wall(**given):
    return brought([Inequality(wall)], **given)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("attempt", "told"),
    [
        (lambda: brought([wall]), r"constraints\[0\]` must be an Inequality or an Equality"),
        (
            lambda: brought([Inequality(wall, slack=5.0)]),
            r"\[0\].slack` must be a Slack, but got fl",
        ),
        (
            lambda: brought([Inequality(wall, Slack(None))]),
            r"\[0\].slack.linear` must be a number or a tensor, but got None",
        ),
        (lambda: brought(Inequality(wall)), "`constraints` must be a sequence, but got Inequality"),
        (lambda: listed([wall]), "`constraints` must be Constraints, but got list"),
        (lambda: beside_a_wall(box=tuple(BOX)), "`bounds` must be Bounds, but got tuple"),
        (lambda: beside_a_wall(box=Bounds([-1.0], [1.0])), "`bounds.lower` must be a tensor, but"),
        (lambda: beside_a_wall(multipliers=[[0.0]]), r"`multipliers\[0\]` must be a tensor, but"),
        (lambda: ConstrainedILQR(None), "`solver` must be an ILQR, but got None"),
    ],
)
def test_what_is_of_another_kind_is_refused(attempt, told):
    with pytest.raises(TypeError, match=told):
        attempt()


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("attempt", "told"),
    [
        (
            lambda: beside_a_wall(multipliers=[torch.zeros(3, 16, 2)]),
            "multipliers.*must have shape",
        ),
        (lambda: ConstrainedILQR(tolerance=0.0), "tolerance.*must be positive"),
    ],
    ids=["multipliers", "tolerance"],
)
def test_what_does_not_fit_a_constrained_problem_is_refused(attempt, told):
    with pytest.raises(ValueError, match=told):
        attempt()


def test_derivatives_of_iterations_are_refused_with_constraints():
    """They are implicit whatever the solver says, but for problems that touch no constraint."""
    with pytest.raises(
        ValueError, match=r"`solver.gradient` must be Implicit\(\) with const.*Leave"
    ):
        ConstrainedILQR(ILQR(gradient=Unrolled()))


def test_constraints_without_rows_constrain_nothing():
    """Such as those of nobody to keep clear of."""
    nobody = Inequality(lambda x, u: x[..., :0])
    free, none = brought([]), brought([nobody])
    assert all((a == b).all() for a, b in zip(free.solution, none.solution, strict=True))
    assert [each.shape for each in none.multipliers] == [(3, 16, 0)]
    assert brought([nobody], multipliers=none.multipliers).converged.all()


def test_a_price_per_problem_is_selected_with_it():
    price = torch.linspace(0.2, 2.0, 12)[:, None, None]
    state, guess = torch.zeros(12, 2), torch.zeros(12, 15, 1)
    limit = Inequality(Batched(wall), Slack(price), slice(-1, None))
    solution = SOLVER(Batched(cart), Batched(reach), [limit], BOX, state, guess)
    assert solution.converged.all()
    assert (solution.states[:, -1, 0].diff() < 0).all()


def test_a_control_that_does_nothing_changes_nothing():
    weight = torch.tensor(0.1, dtype=torch.float64, requires_grad=True)

    def step(x, u):
        return torch.cat([x[..., :1] + 0.1 * x[..., 1:], x[..., 1:] + 0.1 * u[..., :1]], -1)

    def cost(x, u):
        return (x[..., 0] - 2).square() + weight * u[..., 0].square()

    def solved(m):
        slow = Inequality(lambda x, u: x[..., 1:] - 0.5, times=slice(1, None))
        one = torch.ones(m, dtype=torch.float64)
        guess = torch.zeros(1, 8, m, dtype=torch.float64)
        state = torch.zeros(1, 2, dtype=torch.float64)
        solution = ConstrainedILQR(ILQR())(step, cost, [slow], Bounds(-one, one), state, guess)
        assert solution.converged.all()
        slope = torch.autograd.grad(solution.states.square().sum(), weight)[0]
        return solution.states.detach(), slope

    for found, expected in zip(solved(3), solved(1), strict=True):
        torch.testing.assert_close(found, expected)


ENDLESS = Bounds(torch.tensor([-torch.inf]), torch.tensor([torch.inf]))


def place(states, forces):
    return states[..., 0] + 0 * forces[..., 0]


def beyond(states, forces):
    return -states[..., :1] - 2


@pytest.mark.parametrize("warm", [False, True])
def test_a_cost_without_minimum_is_a_status_unless_a_constraint_stops_it(warm):
    start, guess = torch.ones(2, 1), torch.full((2, 6, 1), 0.3)
    given = (torch.zeros(2, 7, 1),) if warm else None
    rest = ENDLESS, start, guess, given

    def step(state, control):
        return state + 0.1 * control

    free = SOLVER(step, place, [Inequality(lambda x, u: x[..., :1] - 2)], *rest)
    assert (free.status == SolverStatus.UNBOUNDED).all()
    stopped = SOLVER(step, place, [Inequality(beyond, times=slice(1, None))], *rest)
    assert stopped.converged.all()
    torch.testing.assert_close(stopped.states[:, 1:], torch.full((2, 6, 1), -2.0))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("settings", "error", "told"),
    [
        ({"function": 5}, TypeError, r"`constraints\[0\].function` must be a function"),
        ({"times": 3}, TypeError, r"times` must be a slice, but got int.*slice\(t, t"),
        ({"times": slice(16, 20)}, ValueError, r"one of the times 0 \.\. 15, but got"),
        (
            {"times": slice(1.0, 3.0)},
            TypeError,
            r"constraints\[0\].times` must be a slice of whole",
        ),
        (
            {"times": slice(0, 9, 0)},
            ValueError,
            r"constraints\[0\].times` must be a slice of whole",
        ),
    ],
    ids=["no function", "a number as times", "times beyond the horizon", "fractions", "no step"],
)
def test_a_constraint_that_would_hold_nowhere_is_refused(settings, error, told):
    with pytest.raises(error, match=told):
        brought([Inequality(**{"function": wall, **settings})])


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("multipliers", [[], torch.zeros(3, 16, 1)], ids=["too few", "a tensor"])
def test_multipliers_of_other_constraints_are_refused(multipliers):
    with pytest.raises(ValueError, match=r"`multipliers` must be a list of 1, one per constraint"):
        brought([Inequality(wall)], multipliers=multipliers)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("widths", [(2, 1), (1, 1)], ids=["another order", "too narrow"])
def test_each_of_the_multipliers_has_the_shape_of_its_constraint(widths):
    limits = [Inequality(wall), Inequality(lambda x, u: x - 50)]
    given = [torch.zeros(3, 16, width) for width in widths]
    with pytest.raises(ValueError, match=r"`multipliers\[.\]` must have shape \(3, 16, "):
        brought(limits, multipliers=given)


def test_times_in_falling_order_are_the_same_times():
    rising, falling = (
        brought([Inequality(wall, times=slice(*each))]) for each in ((5, None), (None, 4, -1))
    )
    assert torch.equal(rising.controls, falling.controls)


@pytest.mark.usefixtures("nothing_compiled")
@pytest.mark.parametrize("constraints", [[], [Inequality(wall)]], ids=["plain", "constrained"])
def test_a_function_around_a_solve_compiles_and_has_its_gradient(constraints):
    def end(start):
        solver, problem = (SOLVER, (constraints,)) if constraints else (ILQR(), ())
        moved, still = start + 0.1, torch.zeros(3, 15, 1)
        return solver(cart, reach, *problem, BOX, moved, still).states[:, -1].sum() * 2

    start = torch.zeros(3, 2, requires_grad=True)
    expected = torch.autograd.grad(end(start), start)
    found = torch.autograd.grad(torch.compile(end, backend="eager")(start), start)
    assert torch.equal(*expected, *found)
