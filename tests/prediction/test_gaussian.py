"""Closed forms of Gaussians in the plane."""

import torch

from diffstack_mmv.prediction.gaussian import (
    covariance_along,
    log_of_sum,
    rotate_covariance,
)


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
