"""Frames and angles."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from diffstack_mmv.geometry import (
    VARIANCE_FLOOR,
    angle_of,
    between_rows,
    clearance_lack,
    direction,
    distance_to_axis,
    distance_to_outline,
    distance_to_segment,
    last_known,
    left_of,
    length,
    motion_in_frame,
    position_from_frame,
    position_in_frame,
    rotate,
    scale_from_covariance,
    shares_ahead,
    solve_symmetric,
    symmetric_root,
    times_ahead,
    wrap_angle,
)
from diffstack_mmv.types import Discs, Motion, Obstacles

NUMBERS = st.floats(-50, 50)


@given(st.floats(-1000, 1000))
def test_wrapped_angle_points_the_same_way_and_is_short(angle):
    wrapped = wrap_angle(torch.tensor(angle, dtype=torch.float64)).item()
    assert -math.pi <= wrapped <= math.pi
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS, NUMBERS)
def test_leaving_a_frame_undoes_entering_it(x, y, ox, oy, heading):
    position = torch.tensor([x, y], dtype=torch.float64)
    origin = torch.tensor([ox, oy], dtype=torch.float64)
    angle = torch.tensor(heading, dtype=torch.float64)
    inside = position_in_frame(position, origin, angle)
    assert torch.allclose(position_from_frame(inside, origin, angle), position)


@given(NUMBERS, NUMBERS, NUMBERS, st.floats(-4, 0), st.floats(0, 4))
def test_distance_to_an_axis_is_that_to_the_stretch_of_it(x, y, heading, rear, front):
    point, origin = torch.tensor([[x, y], [1.0, -2.0]], dtype=torch.float64)
    heading, rear, front = torch.tensor([heading, rear, front], dtype=torch.float64)
    ends = [origin + each * direction(heading) - point for each in (rear, front)]
    found = distance_to_axis(point, origin, heading, rear, front)
    assert torch.allclose(found, distance_to_segment(*ends), atol=1e-12)


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS, NUMBERS)
def test_distance_to_an_axis_does_not_depend_on_the_frame(x, y, ox, oy, turn):
    point, origin = torch.tensor([[x, y], [ox, oy]], dtype=torch.float64)
    heading, turn = torch.tensor([0.4, turn], dtype=torch.float64)
    ends = torch.tensor([-0.5, 1.5], dtype=torch.float64)
    seen = (position_in_frame(each, torch.ones(2).double(), turn) for each in (point, origin))
    there = distance_to_axis(*seen, heading - turn, *ends)
    assert torch.allclose(there, distance_to_axis(point, origin, heading, *ends), atol=1e-9)


def test_distance_to_an_axis_has_a_derivative_on_it():
    point = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    ahead = torch.tensor([-1.0, 1.0], dtype=torch.float64)
    distance_to_axis(point, torch.zeros(2).double(), ahead[1], *ahead, epsilon=1e-6).backward()
    assert torch.equal(point.grad, torch.zeros(2).double())


def test_rotation_by_a_quarter_turns_forward_to_left():
    quarter = torch.tensor(math.pi / 2)
    assert torch.allclose(
        rotate(torch.tensor([1.0, 0.0]), quarter), torch.tensor([0.0, 1.0]), atol=1e-6
    )
    assert torch.allclose(direction(quarter), torch.tensor([0.0, 1.0]), atol=1e-6)


def test_own_frame_puts_the_motion_at_the_origin_and_keeps_body_rates():
    motion = Motion(
        torch.tensor([3.0, 4.0]), torch.tensor(1.0), torch.tensor([2.0, 0.1]), torch.tensor(0.3)
    )
    own = motion_in_frame(motion, motion.position, motion.heading)
    assert torch.equal(own.position, torch.zeros(2))
    assert own.heading == 0
    assert torch.equal(own.velocity, motion.velocity)
    assert own.yaw_rate == motion.yaw_rate


def test_an_angle_that_is_not_known_is_zero_without_a_slope():
    angles = torch.tensor([-3.0, 0.0, 0.5, 2.0])
    vectors = (2 * direction(angles)).requires_grad_()
    known = torch.tensor([True, True, False, True])
    found = angle_of(vectors, known)
    torch.testing.assert_close(found, torch.where(known, angles, 0.0))
    slope = torch.autograd.grad(found.sum(), vectors)[0]
    assert torch.equal(slope.abs().sum(-1) > 0, known)
    none = torch.zeros(2, requires_grad=True)
    found = angle_of(none, torch.tensor(False))
    assert torch.equal(torch.autograd.grad(found, none)[0], torch.zeros(2))


@pytest.mark.parametrize(
    ("valid", "held"),
    [
        ([1, 1, 1], [1.0, 2.0, 3.0]),
        ([0, 1, 0], [0.0, 2.0, 2.0]),
        ([1, 0, 1], [1.0, 1.0, 3.0]),
        ([0, 0, 0], [0.0, 0.0, 0.0]),
    ],
)
def test_who_is_lost_stays_where_they_were_seen_last(valid, held):
    known = torch.tensor(valid, dtype=torch.bool)
    seen = torch.tensor([1.0, 2.0, 3.0]).unsqueeze(-1).expand(3, 2)
    recorded = torch.where(known.unsqueeze(-1), seen, torch.nan)
    found = last_known(torch.zeros(2, 2), recorded.expand(2, 3, 2), known.expand(2, 3))
    assert torch.equal(found, torch.tensor(held).unsqueeze(-1).expand(2, 3, 2))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_times_ahead_are_those_of_the_ends_of_the_steps(dtype):
    like = torch.zeros(2, dtype=dtype)
    assert torch.equal(times_ahead(like, 3, 0.25), torch.tensor([0.25, 0.5, 0.75], dtype=dtype))
    assert torch.equal(shares_ahead(like, 4), torch.tensor([0.25, 0.5, 0.75, 1.0], dtype=dtype))


@pytest.mark.parametrize(
    ("rows", "values"),
    [([1.0, 2.0, 4.0], [0.0, 1.0, 1.5, 3.0, 6.0]), ([3.0], [3.0] * 5)],
)
def test_between_rows_values_are_interpolated_and_beyond_them_they_go_on(rows, values):
    place = torch.tensor([-1.0, 0.0, 0.5, 1.5, 3.0])
    found = between_rows(torch.tensor(rows).unsqueeze(-1), place)
    assert found.squeeze(-1).tolist() == values


def test_a_length_of_zero_has_a_derivative_of_zero():
    none, apart = (torch.zeros(2).double().requires_grad_() for _ in range(2))
    assert torch.equal(torch.autograd.grad(length(none), none)[0], torch.zeros(2).double())
    found = torch.autograd.grad(distance_to_segment(none, apart), (none, apart))
    assert all(torch.equal(each, torch.zeros(2).double()) for each in found)
    point, same = (torch.tensor([3.0, 4.0]).double().requires_grad_() for _ in range(2))
    slope, _ = torch.autograd.grad(distance_to_segment(point, same), (point, same))
    torch.testing.assert_close(slope, torch.tensor([0.6, 0.8]).double())


def test_a_margin_is_lacked_beside_the_outline_of_the_vehicle():
    """Two discs of 0.3 m that reach from -0.5 to 1.5 m along y, an agent of 0.2 m to the right."""
    zero = torch.zeros(1)
    motion = Motion(torch.zeros(1, 2), zero + math.pi / 2, torch.zeros(1, 2), zero)
    discs = Discs(torch.tensor([-0.5, 1.5]), torch.tensor([0.3, 0.3]))
    beside, ahead = torch.tensor([0.9, 1.0]), torch.tensor([0.0, 2.5])
    position = torch.stack([beside, ahead])[None, :, None]
    agents = Obstacles(position, torch.ones(1, 2), torch.full((1,), 0.2), torch.ones(1) > 0)
    lack = clearance_lack(motion, discs, agents, margin_m=0.5)
    assert torch.allclose(lack, torch.tensor([[[0.1], [0.0]]]), atol=1e-5)


@given(NUMBERS, NUMBERS)
def test_left_is_square_to_forward_and_as_long(x, y):
    forward = torch.tensor([x, y], dtype=torch.float64)
    left = left_of(forward)
    assert torch.dot(forward, left) == 0
    assert torch.allclose(left.norm(), forward.norm())
    assert torch.equal(left_of(left), -forward)


@given(NUMBERS, NUMBERS, st.floats(-7, 7))
def test_distance_to_an_outline_is_that_to_the_axis_between_its_outer_discs(x, y, heading):
    agents, place = torch.tensor([[[[x, y]]]]), torch.tensor([[1.0, -2.0]])
    turn = torch.tensor([heading])
    ahead = torch.tensor([0.3, 1.5, -0.5])
    found = distance_to_outline(agents, place, turn, Discs(ahead, torch.ones(3)))
    ends = place + torch.tensor([[-0.5], [1.5]]) * direction(turn)
    expected = distance_to_segment(*(ends - agents[0, 0, 0]))
    assert torch.allclose(found.flatten(), expected.flatten(), atol=1e-4)


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


def test_symmetric_root_and_its_inverse_are_those_of_the_covariance():
    covariance, vector = covariances(), torch.randn(5, 2, dtype=torch.float64)
    found = symmetric_root(torch.linalg.cholesky(covariance))
    assert torch.allclose(found, found.mT)
    assert torch.allclose(found @ found, covariance)
    assert torch.allclose(solve_symmetric(found, vector), torch.linalg.solve(found, vector))
