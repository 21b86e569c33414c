"""What a decoder says before it has learned: a fading turn, a quarter of a width of doubt."""

import math

import pytest
import torch

from diffstack_mmv.prediction.current import Trend
from diffstack_mmv.prediction.trajectron.decoder import ControlDecoder
from diffstack_mmv.types import Motion
from tests.prediction.samples import DT_S, bicycle

STEPS = 4
FADE_S = 0.3


def decoder():
    return ControlDecoder(bicycle(), 2, 1, STEPS, hidden=4).double()


def base(velocity, acceleration):
    """Accelerations and yaw rates for a component that starts like this, heading anywhere."""
    speed = math.hypot(*velocity)
    pair = torch.tensor([[[speed, 0.0]]]).double()
    zero = torch.zeros(1, 1).double()
    course = zero + math.atan2(velocity[1], velocity[0])
    trend = (torch.tensor([[each]]).double() for each in ((0.0, 0.0), velocity, acceleration))
    start = Trend(*trend)
    found = decoder()._base_controls(Motion(start.offset, course, pair, zero), start)[0, 0]
    order = bicycle().Control._fields
    return found[:, order.index("acceleration")], found[:, order.index("yaw_rate")]


@pytest.mark.parametrize(
    ("velocity", "acceleration", "along", "curvature"),
    [
        ((4.0, 0.0), (1.0, 0.0), 1.0, 0.0),
        ((4.0, 0.0), (0.0, 2.0), 0.0, 2.0 / 16.25),  # to the left
        ((0.0, 4.0), (2.0, 1.0), 1.0, -2.0 / 16.25),  # to the right
        ((4.0, 0.0), (9.0, 0.0), 3.0, 0.0),  # no fit is believed more than 3 m/s²
        ((4.0, 0.0), (-9.0, 0.0), -3.0, 0.0),
        ((0.6, 0.0), (-9.0, 0.0), -2.0, 0.0),  # rest is reached at the end of the fading
        ((1.0, 0.0), (0.0, -9.0), 0.0, -1.0),  # no curve is narrower than 1 m
    ],
)
def test_acceleration_and_curvature_of_the_fit_fade(velocity, acceleration, along, curvature):
    found, turning = base(velocity, acceleration)
    fading = [math.exp(-DT_S * (step + 0.5) / FADE_S) for step in range(STEPS)]
    assert found.tolist() == pytest.approx([along * each for each in fading], abs=1e-3)
    speed = [math.hypot(*velocity) + 0.5 * DT_S * along * each for each in fading]
    rates = [curvature * each * v for each, v in zip(fading, speed, strict=True)]
    assert turning.tolist() == pytest.approx(rates, abs=1e-3)


def test_deviations_are_a_quarter_of_a_width_before_training_and_of_both_controls_apart():
    found = decoder()._scale(torch.zeros(3, STEPS, 3).double())
    assert torch.equal(found, 0.25 * torch.eye(2).double().expand(3, STEPS, 2, 2))


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_deviation_stays_within_a_factor_of_that_before_training(sign):
    found = decoder()._scale(torch.tensor([[sign * 1e3, sign * 1e3, 0.0]]).double())
    assert found[0].diagonal().tolist() == pytest.approx([0.25 * math.exp(sign * 4.0)] * 2)


@pytest.mark.parametrize("raw", [-2.0, 0.5])
def test_a_correlation_does_not_depend_on_the_deviations(raw):
    factor = decoder()._scale(torch.tensor([[0.3, -1.0, raw], [2.0, 0.7, raw]]).double())
    assert (factor.triu(1) == 0).all()
    covariance = factor @ factor.mT
    root = covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    correlation = covariance[:, 1, 0] / root.prod(-1)
    leaning = 4 * math.tanh(raw / 4)
    expected = leaning / math.hypot(1, leaning)
    assert correlation.tolist() == pytest.approx([expected] * 2)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("steps", [0, -1])
def test_a_horizon_without_a_step_is_refused(steps):
    with pytest.raises(ValueError, match="`horizon_steps` must be at least 1"):
        ControlDecoder(bicycle(), 2, 1, steps)


def test_before_training_nothing_is_added_to_the_fading_turn_whatever_the_context():
    """The deviation is a quarter of a quarter of the box, the place is known to centimetres."""
    made, hidden = decoder(), torch.randn(3, 4).double()
    fading = torch.randn(3, STEPS, 2).double()
    controls, scale = made._controls(torch.randn(3, 12).double(), hidden, fading)
    assert torch.equal(controls, fading)
    box = made.dynamics.bounds.upper - made.dynamics.bounds.lower
    torch.testing.assert_close(scale, torch.diag(box / 16).expand(3, STEPS, 2, 2))
    assert (made.start_head(hidden) == 0).all()
