"""Controls by which DiffGM3 does what it is asked for."""

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3
from diffstack_mmv.vehicles import load_vehicle


def driven(name, dt_s=0.1):
    """The model of a vehicle in float64."""
    return DiffGM3(load_vehicle(name), dt_s=dt_s).double()


def riding(speed):
    """A state that goes straight on at a speed in m/s, `1 8`."""
    return torch.nn.functional.pad(torch.tensor([[speed]]).double(), (2, 5))


def after_two_seconds(model, speed, acceleration, curvature):
    """State that control after control leads to."""
    state, asked = riding(speed), torch.tensor([acceleration, curvature]).double()
    for _ in range(round(2.0 / model.dt_s)):
        state = model.step(state, model.control_for(state, asked[:1], asked[1:]))
    return state.detach()[0]


@pytest.mark.parametrize("dt_s", [0.1, 0.25])
@pytest.mark.parametrize(
    ("name", "curvature"),
    [
        ("wheelchair", 0.5),
        ("wheelchair", -1.0),
        ("hoverboard", 0.5),
        ("hoverboard", -1.0),
    ],
)
def test_wheels_that_turn_the_vehicle_do_not_push_it_on(name, curvature, dt_s):
    end = after_two_seconds(driven(name, dt_s), 1.0, 0.0, curvature)
    assert end[2].item() == pytest.approx(1.0, abs=0.05)
    assert (end[5] / end[2]).item() == pytest.approx(curvature, rel=0.06)


def test_a_wheelchair_keeps_to_the_tightest_turn_it_is_asked_for():
    end = after_two_seconds(driven("wheelchair"), 0.5, 0.0, 3.0)
    assert end[2].item() == pytest.approx(0.5, abs=0.15)  # 2.1 m/s without the correction
    assert (end[5] / end[2]).item() == pytest.approx(3.0, rel=0.1)


@pytest.mark.parametrize("name", ["wheelchair", "hoverboard"])
@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_the_gradient_of_a_control_is_exact(name, speed):
    model = driven(name)
    given = [riding(speed), torch.full((1,), 0.3).double(), torch.full((1,), 0.2).double()]
    assert torch.autograd.gradcheck(
        model.control_for, [each.requires_grad_() for each in given], atol=1e-5
    )
