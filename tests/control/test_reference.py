"""Against reference solutions of two problems: optima, gradients, what approximations lose."""

import importlib.util

import numpy as np
import pytest
import torch

from diffstack_mmv.control import ILQR, Batched, Bounds

pytestmark = pytest.mark.usefixtures("double")
PROBLEMS = ("P1", "P2")


@pytest.fixture(scope="module")
def reference(shared):
    """The module that defines the problems, and its reference files by name."""
    folder = shared / "reference" / "mpc"
    spec = importlib.util.spec_from_file_location("reference_problems", folder / "problems.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module, lambda name: np.load(folder / f"{name}.npz")


def posed(module, name, instances, wheelbase=None, weights=None, parameters=None):
    """Callables, box and states of a problem; tensors have one entry per instance."""
    space = module.torch_ns()
    states, given = (torch.tensor(instances[key]) for key in ("x0", "p"))
    parameters = given if parameters is None else parameters
    weights = (
        torch.tensor(module.W_DEFAULT[name]).expand(len(states), 7) if weights is None else weights
    )
    wheelbase = (
        torch.tensor(module.WHEELBASE).expand(len(states)) if wheelbase is None else wheelbase
    )

    def dynamics(state, control, wheelbase):
        return torch.stack(
            module.step(space, name, state.unbind(-1), control.unbind(-1), wheelbase), -1
        )

    def cost(states, controls, parameters, weights):
        p, w = (
            [column.unsqueeze(-1) for column in rows.unbind(-1)] for rows in (parameters, weights)
        )
        stage = module.stage_cost(space, name, states.unbind(-1), controls.unbind(-1), p, w)
        final = module.terminal_cost(space, name, states.unbind(-1), p, w)
        return torch.cat([stage[..., :-1], final[..., -1:]], -1)

    box = Bounds(torch.tensor(module.U_LO[name]), torch.tensor(module.U_HI[name]))
    return Batched(dynamics, wheelbase), Batched(cost, parameters, weights), box, states


@pytest.mark.parametrize("name", PROBLEMS)
def test_optima_from_zero_controls_match_the_interior_point_solver(reference, name):
    module, load = reference
    instances = {key: value[:64] for key, value in module.instances(name).items()}
    solution = ILQR()(*posed(module, name, instances), torch.zeros(64, 30, 2))
    costs, violation = module.true_cost(
        name, instances["x0"], instances["p"], solution.controls.numpy()
    )
    assert solution.converged.all()
    assert violation.max() == 0
    assert (costs <= load(f"reference_{name}")["J_start0"][:64] * (1 + 1e-4)).mean() >= 0.95


@pytest.mark.parametrize("name", PROBLEMS)
def test_gradient_equals_the_reference_jacobian(reference, name):
    error = np.linalg.norm(
        jacobian(reference, name) - reference[1](f"gradient_{name}")["Jimp"], axis=(1, 2)
    )
    scale = np.linalg.norm(reference[1](f"gradient_{name}")["Jimp"], axis=(1, 2))
    assert (error / scale).max() < 1e-9


@pytest.mark.parametrize("name", PROBLEMS)
def test_gauss_newton_gradient_is_wrong_by_percents(reference, name, monkeypatch):
    """What differentiating the last linear-quadratic approximation gives: no curvature of f."""
    drop_dynamics_curvature(monkeypatch)
    exact = reference[1](f"gradient_{name}")["Jimp"]
    error = np.abs(jacobian(reference, name) - exact)
    relative = np.median(error.sum((1, 2)) / np.abs(exact).sum((1, 2)))
    assert 0.005 < relative < 1


def drop_dynamics_curvature(monkeypatch):
    from diffstack_mmv.control import expansion

    whole = expansion.dynamics_curvature

    def none(*arguments):
        return expansion.HessianBlocks(*(torch.zeros_like(block) for block in whole(*arguments)))

    monkeypatch.setattr(expansion, "dynamics_curvature", none)


def jacobian(reference, name, count=64):
    """Derivatives of first control and final position by weights, wheelbase and goal."""
    module, load = reference
    instances = {key: value[:count] for key, value in module.instances(name).items()}
    weights = torch.tensor(module.W_DEFAULT[name]).repeat(count, 1).requires_grad_()
    wheelbase = torch.full((count,), module.WHEELBASE, requires_grad=True)
    parameters = torch.tensor(instances["p"]).requires_grad_()
    problem = posed(module, name, instances, wheelbase, weights, parameters)
    start = torch.tensor(load(f"gradient_{name}")["u"])[:count]
    solution = ILQR(tolerance=1e-16)(*problem, start)
    outputs = torch.cat([solution.controls[:, 0], solution.states[:, -1, :2]], -1)
    rows = []
    for i in range(4):
        inputs = (weights, wheelbase, parameters)
        w, length, p = torch.autograd.grad(
            outputs[:, i].sum(),
            inputs,
            retain_graph=True,
            allow_unused=True,
            materialize_grads=True,
        )
        rows.append(torch.cat([w, length.unsqueeze(-1), p[:, :2]], -1))
    return torch.stack(rows, 1).numpy()


@pytest.mark.slow
@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_thousand_problems_converge(reference, name, dtype):
    module, _ = reference
    instances = module.instances(name, 1000, seed=7)
    dynamics, cost, box, states = posed(module, name, instances)
    narrow = [
        Batched(part.function, *(tensor.to(dtype) for tensor in part.tensors))
        for part in (dynamics, cost)
    ]
    box = Bounds(*(bound.to(dtype) for bound in box))
    solution = ILQR()(*narrow, box, states.to(dtype), torch.zeros(1000, 30, 2, dtype=dtype))
    assert solution.converged.double().mean() >= 0.995
    assert all(part.isnan().sum() == 0 for part in solution)


@pytest.mark.slow
@pytest.mark.parametrize("name", PROBLEMS)
def test_zero_controls_reach_what_the_interior_point_solver_reaches_from_them(reference, name):
    module, load = reference
    instances = module.instances(name)
    solution = ILQR()(*posed(module, name, instances), torch.zeros(256, 30, 2))
    controls = solution.controls.numpy()
    costs, _ = module.true_cost(name, instances["x0"], instances["p"], controls)
    assert (costs <= load(f"reference_{name}")["J_start0"] * (1 + 1e-4)).mean() >= 0.97


@pytest.mark.slow
@pytest.mark.parametrize("name", PROBLEMS)
def test_a_few_starts_reach_the_best_known_optimum(reference, name):
    module, load = reference
    instances = module.instances(name)
    problem = posed(module, name, instances)
    lower, upper = problem[2]
    best = np.full(256, np.inf)
    for level in start_levels(lower, upper):
        controls = level.expand(256, 30, 2)
        solution = ILQR(tolerance=1e-8)(*problem, controls)
        costs, _ = module.true_cost(
            name, instances["x0"], instances["p"], solution.controls.numpy()
        )
        best = np.minimum(best, costs)
    assert (best <= load(f"reference_{name}")["J"] * (1 + 1e-4)).mean() >= 0.97


def start_levels(lower, upper):
    """Constant controls: nothing, and each combination of a third of the way to the bounds."""
    yield torch.zeros(2)
    for first in (lower[0], 0 * lower[0], upper[0]):
        for second in (lower[1], 0 * lower[1], upper[1]):
            yield torch.stack([first, second]) / 3
