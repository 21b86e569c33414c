"""Box QPs are solved exactly, whatever their active set."""

import itertools

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from diffstack_mmv.control.box_qp import (
    free_inverse,
    parted,
    positive_lift,
    regular_inverse,
    solve_box_qp,
)

pytestmark = pytest.mark.usefixtures("double")


def minimum_over_active_sets(H, g, lower, upper):
    """The cheapest feasible stationary point of all 3^m active sets."""
    m, N = g.shape
    best, best_value = torch.zeros_like(g), torch.full((N,), torch.inf)
    for sides in itertools.product((-1, 0, 1), repeat=m):
        free = [i for i in range(m) if sides[i] == 0]
        fixed = [i for i in range(m) if sides[i] != 0]
        k = torch.where(torch.tensor(sides).unsqueeze(-1) < 0, lower, upper)
        pull = g[free] + torch.einsum("abN,bN->aN", H[free][:, fixed], k[fixed])
        block = H[free][:, free].movedim(-1, 0)
        k[free] = -torch.linalg.solve(block, pull.T.unsqueeze(-1)).squeeze(-1).T
        feasible = ((k >= lower - 1e-9) & (k <= upper + 1e-9)).all(0)
        value = ((0.5 * torch.einsum("abN,bN->aN", H, k) + g) * k).sum(0)
        better = feasible & (value < best_value)
        best, best_value = torch.where(better, k, best), torch.where(better, value, best_value)
    return best


def random_problems(m, spread, count=200):
    """Definite matrices whose entries differ by `spread` orders of magnitude, tight boxes."""
    X, scale = torch.randn(m, m, count), 10 ** (spread * (torch.rand(m, count) - 0.5))
    H = torch.einsum("xyN,zyN->xzN", X, X) + 1e-2 * torch.eye(m).unsqueeze(-1)
    lower, upper = -torch.rand(m, count), torch.rand(m, count)
    lower = torch.where(torch.rand(m, count) < 0.2, 0.0, lower)  # at a bound already
    return H * scale * scale.unsqueeze(1), 3 * torch.randn(m, count) * scale, lower, upper


@pytest.mark.parametrize("spread", [0, 4])
@pytest.mark.parametrize("m", [1, 2, 3, 4, 5, 6])
def test_minimiser_equals_the_best_of_all_active_sets(m, spread):
    problem = random_problems(m, spread)
    k, free = solve_box_qp(*problem)
    torch.testing.assert_close(k, minimum_over_active_sets(*problem), rtol=0, atol=1e-9)
    assert (free == ((k > problem[2]) & (k < problem[3]))).all()


@pytest.mark.parametrize("m", [1, 3, 5])
def test_without_bounds_it_is_the_stationary_point(m):
    H, g, lower, upper = random_problems(m, 1)
    k, free = solve_box_qp(H, g, lower - torch.inf, upper + torch.inf)
    torch.testing.assert_close(torch.einsum("abN,bN->aN", H, k), -g)
    assert free.all()


def test_interval_of_zero_width_holds_its_variable():
    H, g, lower, upper = random_problems(4, 1)
    upper[2] = lower[2]
    k, free = solve_box_qp(H, g, lower, upper)
    assert (k[2] == lower[2]).all()
    assert not free[2].any()


@pytest.mark.parametrize("m", [2, 3, 5])
def test_what_has_no_choice_need_not_be_definite(m):
    """As controls that their bounds hold: their curvature is not lifted."""
    H, g, lower, upper = random_problems(m + 1, 1)
    lower[-1] = upper[-1]
    H[-1, -1] = 1e-3
    H[-1, :-1] = H[:-1, -1] = 100 * torch.randn(m, H.shape[-1])
    k, free = solve_box_qp(H, g, lower, upper)
    pull = g[:-1] + H[:-1, -1] * upper[-1]
    expected = minimum_over_active_sets(H[:-1, :-1], pull, lower[:-1], upper[:-1])
    torch.testing.assert_close(k[:-1], expected, rtol=0, atol=1e-9)
    assert k[-1].equal(upper[-1])


def test_a_problem_that_is_not_finite_leaves_the_others_alone():
    H, g, lower, upper = random_problems(3, 1)
    expected = solve_box_qp(H, g, lower, upper)[0]
    H[..., 7] = torch.nan
    k = solve_box_qp(H, g, lower, upper)[0]
    assert k[:, torch.arange(200) != 7].equal(expected[:, torch.arange(200) != 7])


DEFINITE = 1e-6


@pytest.mark.usefixtures("double")
@given(m=st.integers(1, 6), seed=st.integers(0, 10_000), spread=st.floats(0, 6))
def test_a_lifted_matrix_is_definite(m, seed, spread):
    """Whatever its eigenvalues and scales; what is definite already is not touched."""
    generator = torch.Generator().manual_seed(seed)
    basis = torch.randn(m, m, 50, generator=generator)
    values = torch.randn(m, 50, generator=generator)
    scale = 10 ** (spread * (torch.rand(m, 50, generator=generator) - 0.5))
    Q = torch.einsum("ikN,kN,jkN->ijN", basis, values, basis) * scale * scale.unsqueeze(1)
    lift = positive_lift(Q, DEFINITE)
    smallest = torch.linalg.eigvalsh(Q.movedim(-1, 0))[:, 0]
    lifted = (Q + torch.diag_embed(lift.T).movedim(0, -1)).movedim(-1, 0)
    size = Q.abs().amax((0, 1))
    assert (lift >= 0).all()
    assert (torch.linalg.eigvalsh(lifted)[:, 0] > -1e-12 * size).all()
    assert (lift.amax(0) <= 2 * m**2 * size).all()
    assert ((lift == 0).all(0) | (smallest < 2 * m**2 * DEFINITE * size)).all()


@pytest.mark.parametrize("m", [1, 2, 3, 5])
def test_negative_curvature_is_lifted_to_its_modulus(m):
    """A diagonal one shows it: each entry on its own, none to zero."""
    diagonal = torch.tensor([2.0, -1.0, 0.5, -3.0, 4.0])[-m:].unsqueeze(-1)
    Q = torch.diag_embed(diagonal.T).movedim(0, -1)
    torch.testing.assert_close(diagonal + positive_lift(Q, DEFINITE), diagonal.abs())


@pytest.mark.parametrize("m", [2, 3, 5])
def test_a_definite_matrix_is_not_lifted_in_any_units(m):
    basis = torch.randn(m, m, 50)
    Q = torch.einsum("ikN,jkN->ijN", basis, basis) + torch.eye(m).unsqueeze(-1)
    unit = torch.logspace(0, -5, m).unsqueeze(-1)
    assert (positive_lift(Q * unit * unit.unsqueeze(1), DEFINITE) == 0).all()


@pytest.mark.parametrize("m", [2, 4])
def test_lift_of_a_matrix_that_is_not_finite_stays_with_it(m):
    Q = torch.randn(m, m, 3)
    Q = Q + Q.transpose(0, 1)
    alone = positive_lift(Q[..., :2], DEFINITE)
    Q[..., 2] = torch.nan
    assert torch.equal(positive_lift(Q, DEFINITE)[:, :2], alone)


def symmetric(m, count=50):
    """Indefinite matrices that are far from singular, and some of their rows."""
    basis = torch.linalg.qr(torch.randn(count, m, m)).Q
    values = (0.5 + torch.rand(count, 1, m)) * torch.randn(count, 1, m).sign()
    return ((basis * values) @ basis.mT).movedim(0, -1), torch.rand(m, count) < 0.6


@pytest.mark.parametrize("m", [1, 2, 3, 5])
@pytest.mark.parametrize("inverse", [free_inverse, regular_inverse])
def test_the_inverse_is_that_of_the_free_rows_and_columns(m, inverse):
    H, free = symmetric(m)
    noise = [torch.full((m, 50), 1e-13)] if inverse is regular_inverse else []
    found = inverse(H, free, *noise)
    for number in range(50):
        rows = free[:, number].nonzero().squeeze(-1)
        expected = torch.zeros(m, m)
        block = H[rows][:, rows, number]
        expected[rows.unsqueeze(-1), rows] = torch.linalg.inv(block)
        scale = expected.abs().max().clamp_min(1)
        torch.testing.assert_close(found[..., number] / scale, expected / scale)


@pytest.mark.parametrize("rank", [1, 2])
def test_of_a_singular_matrix_as_many_rows_are_inverted_as_its_rank(rank):
    """With them every equation that can be met is met; what is left over stays at zero."""
    factor = torch.randn(50, 4, rank)
    H = (factor @ factor.mT).movedim(0, -1)
    found = regular_inverse(H, torch.ones(4, 50) > 0, torch.full((4, 50), 1e-9)).movedim(-1, 0)
    assert ((found != 0).any(-1).sum(-1) == rank).all()
    each = H.movedim(-1, 0)
    torch.testing.assert_close(each @ found @ each, each)


def test_the_noise_of_a_row_tells_whether_it_has_an_inverse():
    H = torch.diag(torch.tensor([4.0, 1e-3, 1e-3]))[..., None]
    noise = torch.tensor([1e-6, 1e-2, 1e-6])[:, None]
    found = regular_inverse(H, torch.ones(3, 1) > 0, noise)[..., 0]
    torch.testing.assert_close(found, torch.diag(torch.tensor([0.25, 0.0, 1e3])))


def test_a_row_that_is_not_free_keeps_its_diagonal_alone():
    Q = torch.tensor([[1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, 6.0]])
    free = torch.tensor([True, False, True])
    alone = [[1.0, 0.0, 3.0], [0.0, 4.0, 0.0], [3.0, 0.0, 6.0]]
    assert parted(Q[..., None], free[:, None])[..., 0].tolist() == alone
