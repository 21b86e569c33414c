"""The side slip of a vehicle whose course alone is known."""

import math

import pytest
import torch

from diffstack_mmv.dynamics.gm3.side_slip import body_motion, side_slip
from diffstack_mmv.geometry import rotate
from diffstack_mmv.smooth import limiter_gain
from diffstack_mmv.types import Motion


def number(value):
    return torch.tensor(value, dtype=torch.float64)


@pytest.mark.parametrize("axle_m", [-0.6, -0.2, 0.0, 0.3])
@pytest.mark.parametrize("yaw_rate", [-1.5, -0.2, 0.7])
def test_the_axle_that_does_not_steer_does_not_slip(axle_m, yaw_rate):
    speed = 6.0
    slip = side_slip(number(speed), number(yaw_rate), axle_m).item()
    across = speed * math.sin(slip) + axle_m * yaw_rate
    assert across == pytest.approx(0.0, abs=0.01 * abs(yaw_rate))


@pytest.mark.parametrize("speed", [0.0, 0.05, 3.0])
@pytest.mark.parametrize("yaw_rate", [-50.0, -1.0, 0.0, 1.0, 50.0])
def test_it_is_odd_below_a_quarter_turn_and_smooth_at_any_speed(speed, yaw_rate):
    inputs = number(speed).requires_grad_(), number(yaw_rate).requires_grad_()
    slip = side_slip(*inputs, -0.5)
    assert slip.abs() < math.pi / 2
    assert torch.equal(side_slip(inputs[0], -inputs[1], -0.5), -slip)
    assert torch.autograd.gradcheck(lambda v, r: side_slip(v, r, -0.5), inputs)


@pytest.mark.parametrize("yaw_rate", [-30.0, -9.0, 4.0, 12.0])
def test_it_is_the_arcsine_of_a_ratio_that_is_limited_softly(yaw_rate: float) -> None:
    speed, axle_m = number(6.0), -0.6
    ratio = -axle_m * yaw_rate / speed
    sine = side_slip(speed, number(yaw_rate), axle_m).sin()
    torch.testing.assert_close(sine, ratio * limiter_gain(ratio), rtol=2e-3, atol=0)


@pytest.mark.parametrize("speed", [-3.0, -0.2, 0.1, 0.2, 0.4])
def test_half_of_it_is_left_at_the_slow_speed_and_reverse_turns_it_around(speed: float) -> None:
    slow, yaw_rate = number(speed), number(1e-3)
    share = slow * side_slip(slow, yaw_rate, -0.5) / (0.5 * yaw_rate)
    assert float(share) == pytest.approx(speed**2 / (speed**2 + 0.2**2), rel=1e-4)


def test_a_course_at_rest_says_nothing_of_the_heading():
    assert side_slip(number(0.0), number(2.0), -0.5) == 0


@pytest.mark.parametrize("yaw_rate", [-0.9, 0.7])
def test_the_body_moves_along_the_course_that_it_was_told(yaw_rate):
    velocity = torch.tensor([6.0, 0.0], dtype=torch.float64)
    course = Motion(torch.zeros(2).double(), number(0.4), velocity, number(yaw_rate))
    body = body_motion(course, -0.5)
    assert torch.allclose(rotate(body.velocity, body.heading), rotate(velocity, course.heading))
    assert body.velocity[1] * yaw_rate > 0  # the axle behind follows on the inside
