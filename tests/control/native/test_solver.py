"""A generated library does what the eager solver does, step by step."""

import pytest
import torch

from diffstack_mmv.control import ILQR, Batched, Bounds, SolverStatus, native
from diffstack_mmv.control.native import solver as native_solver
from diffstack_mmv.control.native.capture import Recorder, Trajectory
from diffstack_mmv.control.native.lowering import CannotLowerError
from diffstack_mmv.control.native.scalar import Program
from diffstack_mmv.control.native.stages import Sizes, staged
from diffstack_mmv.dynamics import DiffGM3, DiffKBM
from diffstack_mmv.vehicles import load_vehicle
from tests.control.problems import DT, driving, goal_cost, rate_model, solve

EXACT = ILQR(tolerance=1e-12)


def natively(solver, dynamics, cost, bounds, state, controls):
    """The solution of the generated library, which must be there."""
    exact = solver.curvature.is_exact(state.shape[-1])
    numbers = native.Numbers(
        solver.settings(bounds, state), solver.max_iterations, exact, solver.one_by_one
    )
    return native.solve(dynamics, cost, numbers, state, controls)


def by_library(*arguments):
    return natively(EXACT, *arguments)


@pytest.fixture
def forget(monkeypatch):
    """Forgets every library and refusal: before the test, wherever it is called, and after."""

    def forgotten():
        monkeypatch.setattr(native_solver, "_LIBRARIES", {})
        native_solver._workshop.cache_clear()

    forgotten()
    yield forgotten
    native_solver._workshop.cache_clear()


def goal_term(states, controls, goal, weight):
    """A cost whose first tensor has one entry per problem."""
    return goal_cost(goal, weight)(states, controls)


def problem(count):
    """Callables with hidden tensors that require gradients, and the rest of a call."""
    torch.set_default_dtype(torch.float64)
    try:
        hidden, box, controls = driving(batch=(count,), limit=1.0)
    finally:
        torch.set_default_dtype(torch.float32)
    leaves = [hidden[name].requires_grad_() for name in ("state", "wheelbase", "weight", "goal")]
    weight = hidden["weight"]

    def term(states, controls, goal):
        return goal_term(states, controls, goal, weight)

    dynamics = Batched(rate_model(hidden["wheelbase"]))
    return (dynamics, Batched(term, hidden["goal"]), box, hidden["state"], controls), leaves


def outcome(solution, leaves):
    """A solution and its gradients by the leaves."""
    loss = (
        solution.states.sin().sum() + solution.controls.square().sum() + 0.3 * solution.cost.sum()
    )
    return solution, torch.autograd.grad(loss, leaves)


@pytest.mark.parametrize("count", [1, 3])
def test_solutions_and_gradients_equal_the_eager_ones_to_rounding(count):
    arguments, leaves = problem(count)
    expected, slopes = outcome(EXACT(*arguments), leaves)
    found, others = outcome(natively(EXACT, *arguments), leaves)
    assert torch.equal(found.status, expected.status)
    assert torch.equal(found.iterations, expected.iterations)
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-10)
    torch.testing.assert_close(others, slopes, rtol=1e-8, atol=1e-9)
    assert (expected.controls.abs().amax((1, 2)) == 1.0).all()  # some bounds are active


@pytest.mark.parametrize("part", ["cost", "states"])
def test_a_second_derivative_is_refused_where_slopes_are_constant_too(part):
    arguments, leaves = problem(3)
    value = getattr(natively(EXACT, *arguments), part).sum()
    slopes = torch.autograd.grad(value, leaves, create_graph=True)
    for slope, leaf in zip(slopes, leaves, strict=True):
        with pytest.raises(RuntimeError, match="be differentiated once"):
            torch.autograd.grad(slope.sum() + leaf.square().sum(), leaf, retain_graph=True)


@pytest.mark.usefixtures("double")
def test_slopes_by_learned_numbers_of_the_dynamics_equal_the_eager_ones():
    """Eight of the eleven times are differentiated at once, then three, by every operation."""
    p = torch.linspace(0.4, 1.3, 15).requires_grad_()

    def step(state, control):
        a, b = state.unbind(-1)
        force = p[0] * control[..., 0] + p[1] * torch.tanh(p[2] * a) - 0.1 * (p[3] + b * b).sqrt()
        force = force + torch.where(a > 0.3 * p[4], p[5] * a, p[6] * a * a)
        force = force + torch.maximum(p[7] * b, -b) + torch.minimum(a, p[8] * b)
        force = force + torch.atan2(b, p[9] + a * a) + (p[10] + a * a).pow(p[11]) / p[12]
        force = force + (-p[13] * b * b).exp() - (p[14] * a - b).abs()
        return torch.stack([a + DT * b, b + DT * force], -1)

    def cost(states, controls):
        return (states - 0.7).square().sum(-1) + 0.1 * controls.square().sum(-1)

    box, state = Bounds(torch.tensor([-2.0]), torch.tensor([2.0])), torch.tensor([[0.1, -0.2]])
    arguments = step, cost, box, state, torch.zeros(1, 11, 1)
    slopes = [outcome(solve(*arguments), [p])[1][0] for solve in (EXACT, by_library)]
    assert (slopes[0] != 0).sum() > 12
    torch.testing.assert_close(slopes[1], slopes[0], rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(("steps", "agents"), [(15, 0), (1, 0), (1, 2)])
def test_one_vehicle_without_any_batch_dimension(steps, agents):
    """A kink of the vehicle then chooses by a truth that is no array; nobody may be there."""
    torch.set_default_dtype(torch.float64)
    try:
        bicycle = DiffKBM(load_vehicle("bicycle"), 0.1)
        goal = torch.tensor([4.0, 1.5])

        people = torch.tensor([[2.0, 1.0], [3.0, -1.0]])[:agents]

        def to_goal(states, controls):
            far = (states[..., None, :2] - people).square().sum(-1)
            price = (states[..., :2] - goal).square().sum(-1) + (-far).exp().sum(-1)
            return price + 0.1 * controls.square().sum(-1)

        state, guess = torch.tensor([0.0, 0.0, 0.0, 2.0]), torch.zeros(steps, 2)
        arguments = bicycle, to_goal, bicycle.bounds, state, guess
        expected, found = EXACT(*arguments), natively(EXACT, *arguments)
    finally:
        torch.set_default_dtype(torch.float32)
    assert found.converged
    assert torch.equal(found.iterations, expected.iterations)
    torch.testing.assert_close(found.states, expected.states, rtol=1e-8, atol=1e-8)


def test_a_problem_without_batch_and_new_closures_use_the_same_library(monkeypatch):
    arguments, _ = problem(1)
    natively(EXACT, *arguments)
    monkeypatch.setattr(native_solver, "source", None)  # nothing is generated any more
    (dynamics, cost, box, state, controls), leaves = problem(1)
    with torch.no_grad():
        leaves[3] += 0.2
    expected = EXACT(dynamics, cost, box, state, controls)
    found = natively(EXACT, dynamics, cost, box, state, controls)
    torch.testing.assert_close(found.controls, expected.controls, rtol=1e-9, atol=1e-10)


def test_what_is_not_finite_or_not_finished_says_so_and_has_no_gradient():
    arguments, leaves = problem(3)
    with torch.no_grad():
        arguments[3][1, 0] = torch.nan
    solver = ILQR(max_iterations=2)
    expected, found = solver(*arguments), natively(solver, *arguments)
    limit, lost = SolverStatus.ITERATION_LIMIT, SolverStatus.NOT_FINITE
    assert found.status.tolist() == expected.status.tolist() == [limit, lost, limit]
    torch.testing.assert_close(found.states, expected.states)
    assert all((slope == 0).all() for slope in outcome(found, leaves)[1])


@pytest.mark.parametrize(("m", "limit"), [(1, 0.5), (3, 0.5), (3, 0.05), (6, 0.2)])
def test_linear_quadratic_problems_start_from_their_solution(m, limit):
    """Unstable systems whose controls meet their bounds, here and there or nearly everywhere."""
    generator = torch.Generator().manual_seed(3)
    draw = torch.randn(4, 6 + m, generator=generator, dtype=torch.float64)
    A, B, b = torch.eye(4) + 0.4 * draw[:, :4], draw[:, 4:-2], draw[:, -2]

    def linear(state, control):
        return (state.unsqueeze(-2) * A).sum(-1) + (control.unsqueeze(-2) * B).sum(-1) + b

    def square(states, controls):
        return states.square().sum(-1) + 0.5 * controls.square().sum(-1)

    highest = torch.full((m,), limit, dtype=torch.float64)
    box = Bounds(-highest, highest)
    start, guess = draw[:, -1].unsqueeze(0), torch.zeros(1, 8, m).double()
    expected = EXACT(linear, square, box, start, guess)
    found = natively(EXACT, linear, square, box, start, guess)
    assert expected.converged.all()
    assert found.converged.all()
    assert (expected.controls.abs() == limit).sum() > 3
    torch.testing.assert_close(found.controls, expected.controls, rtol=1e-9, atol=1e-9)


def test_a_problem_that_has_no_scalar_form_is_left_to_the_tensor_kernels(caplog):
    arguments, _ = problem(1)

    def sorted_cost(states, controls):
        return states.sort(-1).values[..., 0] + controls.square().sum(-1)

    with caplog.at_level("INFO"):
        assert natively(EXACT, arguments[0], sorted_cost, *arguments[2:]) is None
    assert "aten.sort" in caplog.text
    assert natively(EXACT, arguments[0], sorted_cost, *arguments[2:]) is None


@pytest.mark.parametrize("count", [0, 17])
def test_many_problems_are_left_to_the_tensor_kernels(count):
    (dynamics, cost, box, state, controls), _ = problem(1)
    many = state.repeat(count, 1), controls.repeat(count, 1, 1)
    assert natively(EXACT, dynamics, cost, box, *many) is None


def test_closures_over_a_batch_are_left_to_the_tensor_kernels_and_told_once(caplog):
    (_, _, box, state, controls), (_, wheelbase, weight, goal) = problem(3)
    native_solver._tell_together.cache_clear()
    closed = goal_cost(goal, weight)
    with caplog.at_level("INFO"):
        for _ in range(2):
            assert natively(EXACT, rate_model(wheelbase), closed, box, state, controls) is None
    assert caplog.text.count("Give Batched(dynamics), Batched(cost, tensor, ...)") == 1


def test_the_compiled_solver_uses_the_library_for_one_problem(monkeypatch):
    hidden, box, controls = driving(batch=(1,))
    asked = []
    monkeypatch.setattr(native, "solve", lambda *arguments: asked.append(arguments) or "solved")
    assert solve(ILQR(compile=True), hidden, box, controls) == "solved"
    assert len(asked) == 1


def test_a_cost_that_sees_another_time_is_refused():
    program = Program()
    x = [program.leaf("x", time, 0) for time in range(3)]
    costs = [x[0], program.apply("mul", x[1], x[0]), x[2]]
    with pytest.raises(CannotLowerError, match="time 1 sees time 0"):
        staged(program, [x[0]], costs, Sizes(1, 1, 2, 0))


@pytest.mark.usefixtures("forget")
def test_what_would_compile_too_long_is_left_to_tensors(monkeypatch, caplog):
    caplog.set_level("INFO")
    monkeypatch.setattr(native_solver, "LONGEST_SOURCE", 100)
    arguments, _ = problem(2)
    assert natively(EXACT, *arguments) is None
    assert "takes too long" in caplog.text


def many_goals(states, controls, goals):
    """A cost whose tensor has another shape for every number of goals."""
    way = states[..., None, :2] - goals[:, None]
    return way.square().sum((-2, -1)) + controls.square().sum(-1)


@pytest.mark.usefixtures("forget")
def test_shapes_beyond_the_limit_are_left_to_tensors_and_the_others_keep_their_libraries(
    monkeypatch, caplog
):
    monkeypatch.setattr(native_solver, "MOST_LIBRARIES", 2)
    (dynamics, _, *rest), _ = problem(2)
    rest[1] = rest[1].detach()

    def found(goals):
        cost = Batched(many_goals, torch.ones(2, goals, 2, dtype=torch.float64))
        return by_library(dynamics, cost, *rest)

    assert [found(goals) is not None for goals in (1, 2, 3, 4, 2, 1)] == [1, 1, 0, 0, 1, 1]
    assert caplog.text.count("in more than 2 shapes") == 1


@pytest.mark.usefixtures("double")
def test_a_long_source_that_is_built_with_less_effort_gives_the_same(monkeypatch, forget):
    seen = []
    load = native_solver.load
    monkeypatch.setattr(
        native_solver, "load", lambda *given: seen.append(given[1:]) or load(*given)
    )
    found = []
    for long in (10**9, 0):
        monkeypatch.setattr(native_solver, "LONG_SOURCE", long)
        monkeypatch.setattr(native_solver, "LONG_ADJOINT", long)
        forget()
        arguments, leaves = problem(2)
        found.append(outcome(natively(EXACT, *arguments), leaves))
    quickly = native_solver.QUICKLY
    assert seen == [(), (), quickly, ("-O1", *quickly)]
    for plain, quick in zip(*found, strict=True):
        torch.testing.assert_close(quick, plain, rtol=1e-9, atol=1e-10)


@pytest.mark.usefixtures("forget")
def test_derivatives_that_cannot_be_built_are_left_to_tensors_before_the_first_solution(
    monkeypatch, caplog
):
    """A training would otherwise end at its first step backward."""
    right = native_solver.source
    monkeypatch.setattr(
        native_solver,
        "source",
        lambda problem, name, real: "no C++" if name == "adjoint" else right(problem, name, real),
    )
    arguments, _ = problem(2)
    with torch.no_grad():
        assert natively(EXACT, *arguments) is not None
    with caplog.at_level("INFO"):
        assert natively(EXACT, *arguments) is None
    assert "No library" in caplog.text


@pytest.mark.parametrize(
    "name",
    [
        "wheelchair",  # the one with casters
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("motorcycle", "tricycle", "tadpole", "skateboard", "cart", "hoverboard")
        ),
    ],
)
def test_every_layout_of_wheels_has_a_scalar_form(name):
    model = DiffGM3(load_vehicle(name), 0.25)
    at = Trajectory(torch.ones(2, 8), torch.zeros(2, len(model.bounds.upper)))
    taken = Recorder()(at, model, lambda states, controls: states.square().sum(-1))
    assert all(each.is_floating_point() for each in taken.parameters)


@pytest.mark.parametrize("power", [1, 2])
def test_a_cost_without_minimum_is_a_status_without_gradient(power):
    state = torch.ones(1, 1, dtype=torch.float64, requires_grad=True)
    controls, endless = torch.full((1, 5, 1), 0.3, dtype=torch.float64), torch.tensor([torch.inf])
    arguments = (
        lambda x, u: x + 0.1 * u,
        lambda x, u: x[..., 0] - u[..., 0].pow(power),
        Bounds(-endless, endless),
        state,
        controls,
    )
    found, expected = natively(EXACT, *arguments), EXACT(*arguments)
    assert found.status.tolist() == expected.status.tolist() == [SolverStatus.UNBOUNDED]
    found.controls.sum().backward()
    assert (state.grad == 0).all()


@pytest.mark.parametrize("guess", [0.0, 0.3])
@pytest.mark.parametrize("count", [1, 3])
def test_slopes_that_are_no_numbers_are_a_status(count, guess):
    """Nothing is below a noise that is no number: the library looked for it beyond its costs."""
    state = torch.arange(count, dtype=torch.float64).unsqueeze(-1)  # the first at the kink
    box = Bounds(*torch.tensor([[-1.0], [1.0]], dtype=torch.float64))

    def root(states, controls, scale):
        far = (scale * states.square().sum(-1)).sqrt()
        return far + controls.square().sum(-1)

    cost = Batched(root, torch.ones(count, 1, dtype=torch.float64))
    step = Batched(lambda state, control: state + control)
    arguments = step, cost, box, state, torch.full((count, 4, 1), guess, dtype=torch.float64)
    expected, found = EXACT(*arguments), natively(EXACT, *arguments)
    assert expected.status[0] == SolverStatus.NOT_FINITE
    assert torch.equal(found.status, expected.status)
    assert torch.equal(found.iterations, expected.iterations)
    torch.testing.assert_close(found.controls, expected.controls, rtol=1e-9, atol=1e-10)
