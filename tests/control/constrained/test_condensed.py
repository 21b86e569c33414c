"""The problem in its controls alone, against its definition and dense solutions one by one."""

import pytest
import torch

from diffstack_mmv.control.constrained.condensed import Condensed, assemble, condense, is_convex
from diffstack_mmv.control.constrained.local import Local

pytestmark = pytest.mark.usefixtures("double")
N, T, STATES, CONTROLS, ROWS = 3, 4, 3, 2, 2
P = T * CONTROLS


def symmetric(*shape):
    half = torch.randn(*shape, shape[-1])
    return half + half.mT


def expansion():
    """A random local model."""
    return Local(
        A=torch.randn(N, T, STATES, STATES),
        B=torch.randn(N, T, STATES, CONTROLS),
        xx=symmetric(N, T + 1, STATES),
        ux=torch.randn(N, T, CONTROLS, STATES),
        uu=symmetric(N, T, CONTROLS),
        costates=torch.zeros(N, T, STATES),
        gradient=torch.zeros(N, T, CONTROLS),
        values_x=torch.randn(N, T + 1, ROWS, STATES),
        values_u=torch.randn(N, T, ROWS, CONTROLS),
        magnitude=torch.ones(N),
        noise=torch.zeros(N),
    )


def followed(local, number, u):
    """States of the linear dynamics of one problem, from zero."""
    states = [torch.zeros(STATES)]
    for A, B, control in zip(local.A[number], local.B[number], u.view(T, CONTROLS), strict=True):
        states.append(A @ states[-1] + B @ control)
    return torch.stack(states)


@pytest.mark.parametrize("number", range(N))
def test_hessian_and_rows_are_those_of_the_states_that_follow_from_the_controls(number):
    local = expansion()

    def lagrangian(u):
        x, each = followed(local, number, u), u.view(T, CONTROLS)
        own = 0.5 * torch.einsum("ta,tab,tb", x, local.xx[number], x)
        mixed = torch.einsum("ta,tab,tb", each, local.ux[number], x[:-1])
        return own + mixed + 0.5 * torch.einsum("ta,tab,tb", each, local.uu[number], each)

    def rows(u):
        of_x = torch.einsum("tka,ta->tk", local.values_x[number], followed(local, number, u))
        of_u = torch.einsum("tka,ta->tk", local.values_u[number], u.view(T, CONTROLS))
        return torch.cat([of_x[:-1] + of_u, of_x[-1:]]).flatten()

    found, place = condense(local), torch.randn(P)
    torch.testing.assert_close(found.hessian[number], torch.func.hessian(lagrangian)(place))
    torch.testing.assert_close(found.jacobian[number], torch.func.jacrev(rows)(place))
    slope = torch.func.jacrev(lambda u: followed(local, number, u))(place)
    torch.testing.assert_close(found.sensitivity[number], slope)


def systems():
    """Condensed problems of very different scales, with unlike numbers of free and active."""
    half = torch.randn(N, P, P)
    hessian = half @ half.mT + torch.eye(P)
    rows = torch.randn(N, 5, P) * torch.tensor([1.0, 1e-4, 1e3, 1.0, 1.0])[:, None]
    free = torch.ones(N, P, dtype=torch.bool)
    free[0, 3], free[1, :2] = False, False
    active = torch.zeros(N, 5, dtype=torch.bool)
    active[0, [1, 2]], active[2, 4] = True, True
    compliance = torch.where(torch.arange(5) == 2, 0.3, 0.0).expand(N, 5)
    scale = torch.tensor([1.0, 1e-6, 1e6])[:, None, None]
    return Condensed(scale * hessian, rows, torch.zeros(N, 1, 1, P)), free, active, compliance


def test_each_system_is_solved_for_its_free_controls_and_active_rows():
    condensed, free, active, compliance = systems()
    of_u, of_rows = torch.randn(N, P), torch.randn(N, 5)
    du, dv = assemble(condensed, free, active, compliance).solve(of_u, of_rows)
    assert (du[~free] == 0).all()
    assert (dv[~active] == 0).all()
    for number in range(N):
        on, held = free[number], active[number]
        M, J = condensed.hessian[number][on][:, on], condensed.jacobian[number][held][:, on]
        D = torch.diag(compliance[number][held])
        matrix = torch.cat([torch.cat([M, J.mT], 1), torch.cat([J, -D], 1)])
        wanted = torch.cat([of_u[number][on], of_rows[number][held]])
        expected = torch.linalg.solve(matrix, wanted)
        found = torch.cat([du[number][on], dv[number][held]])
        torch.testing.assert_close(found, expected, rtol=1e-7, atol=0)


def test_a_problem_is_convex_if_it_is_so_along_its_active_rows():
    hessian = torch.diag(torch.tensor([1.0, -1.0, 2.0])).expand(6, 3, 3)
    rows = torch.tensor([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]).expand(6, 2, 3)
    condensed = Condensed(hessian, rows, torch.zeros(6, 1, 1, 3))
    free = torch.ones(6, 3, dtype=torch.bool)
    free[3, 1] = False  # held by a bound
    active = torch.zeros(6, 2, dtype=torch.bool)
    active[1, 0] = active[2, 1] = active[4, 0] = active[5, 0] = True
    compliance = torch.zeros(6, 2)
    compliance[4, 0], compliance[5, 0] = 0.5, 2.0  # curved by 1 / 0.5 and 1 / 2 along the row
    found = is_convex(condensed, free, active, compliance)
    assert found.tolist() == [False, True, False, True, True, False]
