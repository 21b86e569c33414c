"""Closed forms of Gaussians in the plane."""

import torch

from diffstack_mmv.prediction.gaussian import (
    VARIANCE_FLOOR,
    covariance_along,
    log_of_sum,
    rotate_covariance,
    scale_from_covariance,
)


def covariances(count=5):
    factor = torch.randn(count, 2, 2, dtype=torch.float64)
    return factor @ factor.mT + 0.1 * torch.eye(2, dtype=torch.float64)


def test_factor_equals_cholesky():
    covariance = covariances()
    floored = covariance + VARIANCE_FLOOR * torch.eye(2, dtype=torch.float64)
    assert torch.allclose(scale_from_covariance(covariance), torch.linalg.cholesky(floored))


def test_factor_of_a_zero_covariance_is_the_floor_with_finite_gradient():
    covariance = torch.zeros(2, 2, requires_grad=True)
    scale = scale_from_covariance(covariance)
    scale.diagonal().log().sum().backward()
    assert torch.allclose(scale.detach(), 0.02 * torch.eye(2))
    assert torch.isfinite(covariance.grad).all()


def test_turning_the_axes_equals_turning_the_covariance():
    along, across = torch.tensor([2.0, 1.0]), torch.tensor([0.5, 3.0])
    turned = covariance_along(torch.tensor([0.7, 0.7]), along, across)
    straight = covariance_along(torch.zeros(2), along, across)
    assert torch.allclose(rotate_covariance(straight, torch.tensor(0.7)), turned, atol=1e-5)


def test_the_log_of_a_sum_leaves_out_what_rounding_loses():
    log_joint = torch.tensor([[0.0, -1.0, -30.0], [-200.0, -500.0, -200.0]], requires_grad=True)
    found = log_of_sum(log_joint)
    assert torch.equal(found, torch.logsumexp(log_joint, -1))
    (slope,) = torch.autograd.grad(found.sum(), log_joint)
    assert torch.allclose(slope, log_joint.detach().softmax(-1))
    assert torch.equal(slope == 0, torch.tensor([[False, False, True], [False, True, False]]))
