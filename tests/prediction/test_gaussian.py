"""Closed forms of Gaussians in the plane."""

import math

import numpy as np
import pytest
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


@pytest.mark.parametrize("below", [0.0, 2.5, 8.0, 14.0])
def test_a_component_that_rounding_keeps_has_its_part_in_the_sum(below):
    log_joint = torch.tensor([[-40.0, -40.0 - below]], requires_grad=True)
    found = log_of_sum(log_joint)
    assert found.item() + 40 == pytest.approx(math.log1p(math.exp(-below)), abs=4e-6)
    (slope,) = torch.autograd.grad(found.sum(), log_joint)
    assert slope[0, 1].item() == pytest.approx(1 / (1 + math.exp(below)), rel=1e-3)


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.0])
def test_errors_along_and_across_a_course_lie_in_its_frame(angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    expected = turn @ np.diag([4.0, 0.25]) @ turn.T
    course = torch.tensor([angle], dtype=torch.float64)
    found = covariance_along(course, torch.full_like(course, 2.0), torch.full_like(course, 0.5))
    np.testing.assert_allclose(found[0].numpy(), expected, atol=1e-12)


@pytest.mark.parametrize("angle", [0.4, -1.3, 3.0])
def test_a_covariance_is_turned_counter_clockwise(angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    covariance = np.array([[[2.0, 0.6], [0.6, 1.0]], [[0.3, -0.2], [-0.2, 0.9]]])
    found = rotate_covariance(torch.tensor(covariance), torch.tensor(angle, dtype=torch.float64))
    np.testing.assert_allclose(found.numpy(), turn @ covariance @ turn.T, atol=1e-12)
