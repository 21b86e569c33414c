"""Eliminating the tracks is exact."""

import pytest
import torch

from diffstack_mmv.identification.arrow import Arrow, Box, bounded, reduce, solve

TRACKS, OWN, SHARED = 3, 5, 4


@pytest.fixture
def arrow():
    jacobian = torch.randn(TRACKS, 12, OWN + SHARED)
    own, cross = jacobian[..., :OWN], jacobian[..., OWN:]
    residual = torch.randn(TRACKS, 12, 1)
    return Arrow(
        own.mT @ own,
        own.mT @ cross,
        (cross.mT @ cross).sum(0),
        (own.mT @ residual).squeeze(-1),
        (cross.mT @ residual).sum((0, 2)),
    )


def dense(arrow):
    size = TRACKS * OWN
    matrix = torch.zeros(size + SHARED, size + SHARED)
    for track in range(TRACKS):
        rows = slice(track * OWN, (track + 1) * OWN)
        matrix[rows, rows] = arrow.own[track]
        matrix[rows, size:] = arrow.cross[track]
        matrix[size:, rows] = arrow.cross[track].mT
    matrix[size:, size:] = arrow.shared
    return matrix, torch.cat([arrow.own_gradient.flatten(), arrow.shared_gradient])


def test_schur_complement_is_the_inverse_of_the_marginal_covariance(arrow):
    covariance = torch.linalg.inv(dense(arrow)[0])[-SHARED:, -SHARED:]
    torch.testing.assert_close(torch.linalg.inv(reduce(arrow).information), covariance)


def test_step_solves_the_whole_system(arrow):
    matrix, gradient = dense(arrow)
    step = solve(arrow)
    whole = torch.cat([step.own.flatten(), step.shared])
    torch.testing.assert_close(matrix @ whole, -gradient)


def test_scaling_changes_the_unit_of_the_step_only(arrow):
    factor = torch.tensor([1e-6, 1.0, 10.0, 1e5])
    scaled = solve(arrow.scaled(factor))
    torch.testing.assert_close(scaled.shared * factor, solve(arrow).shared, rtol=1e-6, atol=0.0)
    torch.testing.assert_close(scaled.own, solve(arrow).own)


def test_restriction_holds_the_other_parameters(arrow):
    active = torch.tensor([True, False, True, False])
    step = solve(arrow.restricted(active)).shared
    information, gradient = reduce(arrow)
    torch.testing.assert_close(
        information[active][:, active] @ step, -gradient[active], rtol=1e-8, atol=1e-10
    )


def test_bounded_step_is_the_minimum_inside_the_box(arrow):
    reduced = reduce(arrow)
    box = Box(torch.full((SHARED,), -0.05), torch.full((SHARED,), 0.05))
    step = bounded(reduced, box)
    slope = reduced.information @ step + reduced.gradient
    lower, upper = step <= -0.05, step >= 0.05
    assert bool((lower | upper).any())
    assert bool((slope[~lower & ~upper].abs() < 1e-9).all())
    assert bool((step.abs() <= 0.05).all())


def test_bounds_that_do_not_bind_change_nothing(arrow):
    wide = Box(torch.full((SHARED,), -1e3), torch.full((SHARED,), 1e3))
    torch.testing.assert_close(solve(arrow, wide).shared, solve(arrow).shared)


def test_damping_shortens_the_step(arrow):
    damped = solve(arrow.damped(torch.full((TRACKS,), 10.0), torch.tensor(10.0)))
    assert float(damped.own.norm()) < float(solve(arrow).own.norm())
