"""Convex problems of unstable systems: one solution, its gradient, and a true status."""

import sys

import numpy as np
import pytest
import torch

from diffstack_mmv.control import ILQR, Batched, Bounds, SolverStatus

pytestmark = pytest.mark.usefixtures("double")
EXACT = ILQR(tolerance=1e-16, max_iterations=200)
SLOW = pytest.mark.slow


def affine(state, control, A, B, b):
    return (
        torch.einsum("...ij,...j->...i", A, state)
        + torch.einsum("...ij,...j->...i", B, control)
        + b
    )


def quadratic(states, controls, H):
    both = torch.cat([states, controls], -1)
    return 0.5 * torch.einsum("...ti,...ij,...tj->...t", both, H, both)


def solved(problem, limit, solver=EXACT):
    """Solution from zero controls in the box |u| <= limit; tensors have one entry per problem."""
    A, B, b, H, state = problem
    m = B.shape[-1]
    dynamics, cost = Batched(affine, A, B, b), Batched(quadratic, H)
    box = Bounds(torch.full((m,), -limit), torch.full((m,), limit))
    return solver(dynamics, cost, box, state, torch.zeros(len(state), 20, m))


def published_problem(file):
    """Tensors of a file of published problems, each with one entry per problem."""
    tensors = [torch.tensor(file[key]) for key in ("A", "B", "b", "H", "x0")]
    count = len(tensors[-1])
    shared = [tensor.repeat(count, *[1] * tensor.dim()) for tensor in tensors[:-1]]
    return *shared, tensors[-1]


def unstable(n, m, count=6):
    """Random systems that grow by up to a half in every step."""
    A = torch.eye(n) + 0.4 * torch.randn(count, n, n) / n**0.5
    B, b = torch.randn(count, n, m), torch.randn(count, n)
    return A, B, b, torch.eye(n + m).repeat(count, 1, 1), torch.randn(count, n)


def by_active_sets(A, B, b, H, state, limit, steps=20):
    """Controls by a quadratic program of the controls alone, for one problem."""
    casadi = pytest.importorskip("casadi")
    n, m = B.shape
    free, forced = state.numpy(), np.zeros((n, steps * m))
    Q, R = H[:n, :n].numpy(), H[n:, n:].numpy()
    hessian, linear = np.kron(np.eye(steps), R), np.zeros(steps * m)
    for t in range(steps):
        free, forced = A.numpy() @ free + b.numpy(), A.numpy() @ forced
        forced[:, t * m : (t + 1) * m] += B.numpy()
        hessian, linear = hessian + forced.T @ Q @ forced, linear + forced.T @ Q @ free
    options = {"printLevel": "none", "terminationTolerance": 1e-14}
    solver = casadi.conic("qp", "qpoases", {"h": casadi.DM(hessian).sparsity()}, options)
    result = solver(h=hessian, g=linear, lbx=-limit, ubx=limit)
    return np.array(result["x"]).reshape(steps, m)


@pytest.mark.parametrize("m", [1, 3, 6, *(pytest.param(m, marks=SLOW) for m in (2, 4, 5))])
def test_controls_equal_those_of_a_quadratic_program(m):
    problem = unstable(8, m)
    solution = solved(problem, 1.0)
    assert solution.converged.all()
    assert ((solution.controls.abs() == 1).double().mean((1, 2)) > 0).any()
    for i, controls in enumerate(solution.controls):
        expected = by_active_sets(*(part[i] for part in problem), 1.0)
        np.testing.assert_allclose(controls, expected, rtol=0, atol=1e-6)


@pytest.fixture(scope="module")
def published(shared):
    """Published problems with four controls, and their exact solutions, by name."""
    folder = shared / "reference" / "mpc" / "acados_lqr"
    return lambda name: dict(np.load(folder / f"reference_{name}.npz"))


@pytest.mark.parametrize(
    "name", ["test_umax1", pytest.param("second_umax1", marks=SLOW), "test_umax10000"]
)
def test_published_problems_are_solved_with_their_gradients(published, name):
    file = published(name)
    leaves = [tensor.requires_grad_() for tensor in published_problem(file)]
    solution = solved(leaves, float(file["u_max"]))
    assert solution.converged.all()
    assert np.abs(solution.controls.detach().numpy() - file["u"]).max() < 1e-7
    solution.controls[:, 0].sum().backward()
    for name, leaf in zip(("dA", "dB", "db", "dH", "dx0"), leaves, strict=True):
        found = leaf.grad.numpy()
        found = 0.5 * (found + found.swapaxes(-1, -2)) if name == "dH" else found
        assert (np.abs(found - file[name]) / (1 + np.abs(file[name]))).max() < 1e-6, name


def test_a_promise_of_nothing_does_not_make_a_point_stationary(monkeypatch):
    """What is said to have converged has no projected gradient, whatever the model promises."""
    names = vars(sys.modules[ILQR.__module__])
    plain = names["definite_policies"]

    def promising_nothing(*arguments):
        policies = plain(*arguments)
        policy, none = policies.first, torch.zeros_like
        idle = policy._replace(gains=none(policy.gains), decrease=none(policy.decrease))
        return policies._replace(first=idle, second=None)

    monkeypatch.setitem(names, "definite_policies", promising_nothing)
    solution = solved(unstable(4, 2), 1.0, ILQR(tolerance=1e-16, max_iterations=20))
    assert (solution.residual > 0.1).all()
    assert (solution.status != SolverStatus.CONVERGED).all()
