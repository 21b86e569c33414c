"""The solver finds constrained optima, whatever it is given."""

import pytest
import torch
from scipy.optimize import minimize

from diffstack_mmv.control import (
    ILQR,
    Batched,
    Bounds,
    Constraints,
    DifferencedCurvature,
    SolverStatus,
)
from tests.control.problems import driving, goal_cost, rate_model, solve

SOLVER = ILQR()


def double_integrator(state, control):
    return torch.stack(
        [state[..., 0] + 0.1 * state[..., 1], state[..., 1] + 0.1 * control[..., 0]], -1
    )


def quadratic(states, controls):
    return (states - 1).square().sum(-1) + 0.1 * controls.square().sum(-1)


def box(limit, m=1):
    return Bounds(-limit * torch.ones(m), limit * torch.ones(m))


@pytest.mark.parametrize("limits", [None, Constraints(lambda x, u: x[..., 1:] - 4.0)])
def test_autocast_around_a_solve_changes_nothing(limits):
    transition, push = torch.tensor([[1.0, 0.0], [0.1, 1.0]]), torch.tensor([[0.0, 0.1]])
    start = torch.tensor([0.3, -0.2])

    def step(state, control):
        return state @ transition + control @ push

    def price(states, controls):
        away = (states - 3.3) @ torch.tensor([[1.0, 0.2], [0.2, 1.0]])
        return ((states - 3.3) * away).sum(-1) + 0.1 * controls.square().sum(-1)

    def found():
        return SOLVER(step, price, box(5.0), start, torch.zeros(8, 1), limits).states

    expected = found()
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(found(), expected)


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("limit", [torch.inf, 2.0])
def test_linear_quadratic_problem_equals_a_dense_solver(limit):
    state = torch.tensor([0.3, -0.2])
    solution = SOLVER(double_integrator, quadratic, box(limit), state, torch.zeros(15, 1))

    def total(flat):
        u = torch.tensor(flat).reshape(15, 1).requires_grad_()
        states = [state]
        for control in u:
            states.append(double_integrator(states[-1], control))
        value = quadratic(torch.stack(states), torch.cat([u, torch.zeros(1, 1)])).sum()
        value.backward()
        return value.item(), u.grad.flatten().numpy()

    limits = [(-limit, limit)] * 15
    dense = minimize(
        total, torch.zeros(15).numpy(), jac=True, method="L-BFGS-B", bounds=limits, tol=1e-15
    )
    assert solution.converged
    assert solution.cost.item() == pytest.approx(dense.fun, rel=1e-9)
    torch.testing.assert_close(
        solution.controls.flatten(), torch.tensor(dense.x), rtol=0, atol=1e-4
    )


@pytest.mark.parametrize("limit", [50.0, 3.0, 0.5])
def test_controls_keep_the_box_exactly(limit):
    hidden, bounds, controls = driving(batch=(32,), limit=limit)
    solution = solve(SOLVER, hidden, bounds, controls)
    assert solution.converged.all()
    assert (solution.controls >= bounds.lower).all()
    assert (solution.controls <= bounds.upper).all()


def test_states_follow_the_dynamics():
    hidden, bounds, controls = driving()
    solution = solve(SOLVER, hidden, bounds, controls)
    step = rate_model(hidden["wheelbase"])
    following = step(solution.states[..., :-1, :], solution.controls)
    torch.testing.assert_close(solution.states[..., 1:, :], following, rtol=1e-5, atol=1e-5)


def test_more_iterations_never_raise_the_cost():
    hidden, bounds, controls = driving(batch=(16,))
    costs = [solve(ILQR(max_iterations=k), hidden, bounds, controls).cost for k in range(1, 8)]
    assert (torch.stack(costs).diff(dim=0) <= 1e-5).all()


@pytest.mark.usefixtures("double")
def test_answer_is_free_of_the_batch_mates():
    hidden, bounds, controls = driving(batch=(5,))
    together = solve(SOLVER, hidden, bounds, controls)
    for i in range(5):
        alone = hidden | {name: hidden[name][i] for name in ("goal", "state")}
        single = solve(SOLVER, alone, bounds, controls[i])
        torch.testing.assert_close(single.controls, together.controls[i], rtol=1e-6, atol=1e-8)
        assert single.iterations == together.iterations[i]


@pytest.mark.parametrize("batch", [(), (1,), (2, 3), (0,)])
def test_any_leading_dimensions(batch):
    hidden, bounds, controls = driving(batch=batch)
    solution = solve(SOLVER, hidden, bounds, controls)
    assert solution.states.shape == (*batch, 13, 4)
    assert solution.cost.shape == solution.status.shape == batch
    assert solution.converged.all()


def test_horizon_of_one_step():
    hidden, bounds, controls = driving(steps=1)
    assert solve(SOLVER, hidden, bounds, controls).converged.all()


def test_box_of_zero_width_holds_the_control():
    hidden, _, controls = driving()
    fixed = Bounds(torch.tensor([0.5, -1.0]), torch.tensor([0.5, 1.0]))
    solution = solve(SOLVER, hidden, fixed, controls)
    assert solution.converged.all()
    assert (solution.controls[..., 0] == 0.5).all()


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_scale_of_the_cost_does_not_change_the_plan(scale):
    hidden, bounds, controls = driving()
    dynamics, cost = rate_model(hidden["wheelbase"]), goal_cost(hidden["goal"], hidden["weight"])
    plain = SOLVER(dynamics, cost, bounds, hidden["state"], controls)
    scaled = SOLVER(dynamics, lambda x, u: scale * cost(x, u), bounds, hidden["state"], controls)
    assert scaled.converged.all()
    torch.testing.assert_close(scaled.controls, plain.controls, rtol=0, atol=2e-2)


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("is_linear", [False, True])
def test_a_cost_whose_square_is_no_number_of_single_precision_converges(is_linear, compiled):
    """As of a vehicle that has all but arrived."""

    def bent(state, control):
        return double_integrator(state, control.sin())

    step, solver = double_integrator if is_linear else bent, ILQR(compile=compiled)
    for scale in (1e-18, 1e-21):
        solution = solver(
            step,
            lambda x, u, s=scale: s * quadratic(x, u),
            box(1.0),
            torch.zeros(2),
            torch.zeros(8, 1),
        )
        assert solution.converged
        assert solution.iterations < 15


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("units", [(1e-4, 1.0), (1.0, 1e-4)])
def test_units_of_the_controls_do_not_change_the_plan(units, compiled):
    """As a force in newtons beside an angle in radians, whose curvatures are 1e-8 and 1."""
    hidden, bounds, controls = driving()
    step, cost = rate_model(hidden["wheelbase"]), goal_cost(hidden["goal"], hidden["weight"])
    unit = torch.tensor(units)
    solution = ILQR(compile=compiled)(
        Batched(lambda x, u: step(x, unit * u)),
        Batched(lambda x, u, goal: goal_cost(goal, hidden["weight"])(x, unit * u), hidden["goal"]),
        Bounds(bounds.lower / unit, bounds.upper / unit),
        hidden["state"],
        controls,
    )
    plain = SOLVER(step, cost, bounds, hidden["state"], controls)
    assert solution.converged.all()
    torch.testing.assert_close(unit * solution.controls, plain.controls, rtol=0, atol=2e-2)


@pytest.mark.parametrize("controls_per_step", [1, 2, 3])
def test_any_number_of_controls(controls_per_step):
    m = controls_per_step

    def step(state, control):
        return state + 0.2 * control.tanh()

    solution = SOLVER(
        step,
        lambda x, u: (x - 2).square().sum(-1),
        box(0.8, m),
        torch.zeros(4, m),
        torch.zeros(4, 6, m),
    )
    assert solution.converged.all()
    assert (solution.controls == 0.8).all()


def test_nan_in_one_problem_is_a_status_and_leaves_the_others_alone():
    hidden, bounds, controls = driving()
    clean = solve(SOLVER, hidden, bounds, controls)
    hidden["state"][2, 0] = torch.nan
    solution = solve(SOLVER, hidden, bounds, controls)
    assert solution.status[2] == SolverStatus.NOT_FINITE
    assert all(part.isnan().sum() == 0 for part in solution)
    others = torch.arange(6) != 2
    torch.testing.assert_close(solution.controls[others], clean.controls[others])


def test_three_controls_that_run_away_are_a_status():
    def step(state, control):
        return state + 0.2 * control.exp()

    start = torch.zeros(4, 3)
    start[1] = torch.nan
    start[2] = 1e38
    solution = SOLVER(
        step, lambda x, u: (x**4 - 2).square().sum(-1), box(0.8, 3), start, torch.zeros(4, 6, 3)
    )
    bad = [SolverStatus.NOT_FINITE] * 2
    assert solution.status[1:3].tolist() == bad
    assert solution.converged[[0, 3]].all()


def test_too_few_iterations_are_a_status():
    hidden, bounds, controls = driving()
    solution = solve(ILQR(max_iterations=1), hidden, bounds, controls)
    assert (solution.status == SolverStatus.ITERATION_LIMIT).all()


def test_a_batched_cost_gives_the_same_answers_with_fewer_problems_at_work():
    hidden, bounds, controls = driving(batch=(40,))
    plain = solve(SOLVER, hidden, bounds, controls)
    sizes = []

    def cost(states, padded, goal):
        sizes.append(len(goal))
        return goal_cost(goal, hidden["weight"])(states, padded)

    dynamics = Batched(rate_model(hidden["wheelbase"]))
    narrowed = SOLVER(dynamics, Batched(cost, hidden["goal"]), bounds, hidden["state"], controls)
    assert min(sizes) < 40
    torch.testing.assert_close(narrowed.controls, plain.controls, rtol=0, atol=1e-3)


def test_iterations_after_all_have_finished_change_nothing(monkeypatch):
    hidden, bounds, controls = driving()
    expected = solve(SOLVER, hidden, bounds, controls)
    monkeypatch.setattr("diffstack_mmv.control.ilqr.CHECK_EVERY", {"cpu": 7})
    found = solve(SOLVER, hidden, bounds, controls)
    assert all(one.equal(other) for one, other in zip(found, expected, strict=True))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"controls": torch.zeros(2, 5, 2)}, "leading dimensions"),
        ({"controls": torch.zeros(3, 0, 2)}, "at least one step"),
        ({"controls": torch.zeros(3, 5, 1)}, "shape"),
        ({"controls": torch.zeros(3, 5, 2, dtype=torch.float64)}, "float32"),
        ({"bounds": Bounds(torch.ones(2), -torch.ones(2))}, "in order"),
        (
            {"bounds": Bounds(torch.full((2,), torch.nan), torch.ones(2))},
            "`bounds.lower` must be numb",
        ),
        ({"bounds": Bounds(torch.zeros(5, 2), torch.ones(2))}, "of its own is a constraint"),
        ({"state": torch.tensor(1.0)}, "a last dimension of columns"),
        ({"controls": torch.zeros(3, 5, 0)}, "have a column"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_arguments_that_do_not_fit_are_refused(change, told):
    arguments = {
        "bounds": box(1.0, 2),
        "state": torch.zeros(3, 4),
        "controls": torch.zeros(3, 5, 2),
    } | change
    with pytest.raises(ValueError, match=told):
        SOLVER(rate_model(1.0), lambda x, u: x.sum(-1), **arguments)


@pytest.mark.parametrize(
    "field", ["max_iterations", "tolerance", "line_search_steps", "regularisation"]
)
def test_settings_must_be_positive(field):
    with pytest.raises(ValueError, match=field):
        ILQR(**{field: 0})


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"gradient": "unrolled"}, "`gradient` must be a GradientMode, but got 'unrolled'"),
        ({"curvature": DifferencedCurvature}, "For instance DifferencedCurvature()"),
        ({"tolerance": None}, "`tolerance` must be positive, but got None"),
        ({"max_iterations": "5"}, "`max_iterations` must be a number, but got '5'"),
        ({"max_iterations": 1.5}, "`max_iterations` must be a whole number, but got 1.5"),
        ({"line_search_steps": True}, "`line_search_steps` must be a whole number, but got True"),
    ],
)
def test_settings_of_another_kind_are_refused(settings, told):
    with pytest.raises(ValueError, match="must") as raised:
        ILQR(**settings)
    assert told in str(raised.value)


ENDLESS = {
    "linear": lambda x, u: x.sum(-1) + 0 * u.sum(-1),
    "concave": lambda x, u: -u.square().sum(-1) + 0 * x.sum(-1),
    "of the states": lambda x, u: 0.5 * u.square().sum(-1) - 100 * x.square().sum(-1),
    "logarithm": lambda x, u: -torch.log(1 + u.square().sum(-1)) + 0 * x.sum(-1),
    "beyond all numbers": lambda x, u: -u.pow(4).sum(-1) + 0 * x.sum(-1),
}


def summing(state, control):
    return state + 0.1 * control[..., :1]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("cost", ENDLESS.values(), ids=ENDLESS)
def test_a_cost_without_minimum_is_a_status_without_gradient(cost, dtype):
    state, controls = torch.ones(2, 1, dtype=dtype), torch.full((2, 6, 2), 0.3, dtype=dtype)
    state.requires_grad_()
    solution = SOLVER(summing, cost, box(torch.inf, 2), state, controls)
    assert (solution.status == SolverStatus.UNBOUNDED).all()
    solution.states[:, 1:].sum().backward()
    assert (state.grad == 0).all()


def test_large_controls_and_costs_have_a_minimum_all_the_same():
    def cost(states, controls):
        return (states[..., 0] - 1e12).square() + 1e-9 * controls.square().sum(-1) - 1e30

    state, controls = torch.ones(2, 1, dtype=torch.float64), torch.zeros(2, 6, 2).double()
    assert SOLVER(summing, cost, box(torch.inf, 2), state, controls).converged.all()
