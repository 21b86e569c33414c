"""Controls by which the wheel-speed model does what it is asked for."""

from dataclasses import replace

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3, DriverInput
from diffstack_mmv.dynamics.gm3 import DiffGM3WheelSpeed
from diffstack_mmv.vehicles import load_vehicle

ACCELERATION, CURVATURE = 0.5, 0.1


def driven(name, dt_s):
    """The model of a vehicle in float64."""
    return DiffGM3WheelSpeed(load_vehicle(name), dt_s=dt_s).double()


def riding(model, *speeds):
    """States that go straight on at speeds in m/s, `b 8`."""
    return torch.nn.functional.pad(torch.tensor(speeds).double()[:, None], (2, 5))


@pytest.mark.parametrize("dt_s", [0.1, 0.25])
@pytest.mark.parametrize("name", ["bicycle", "tricycle", "wheelchair", "cart", "hoverboard"])
def test_the_asked_acceleration_is_reached_within_the_step(name, dt_s):
    model = driven(name, dt_s)
    start = riding(model, 0.5, 1.0, 1.5)
    asked = torch.full((3,), ACCELERATION).double()
    for curvature in (0.0, CURVATURE, -CURVATURE):
        control = model.control_for(start, asked, torch.full_like(asked, curvature))
        reached = (model.step(start, control)[:, 2] - start[:, 2]) / dt_s
        torch.testing.assert_close(reached, asked, rtol=0, atol=0.02)


@pytest.mark.parametrize("name", ["bicycle", "tricycle", "wheelchair", "cart", "hoverboard"])
def test_the_asked_curvature_is_held_after_ten_steps(name):
    model = driven(name, 0.1)
    state = riding(model, 0.5, 1.0, 1.5)
    asked = torch.full((3,), CURVATURE).double()
    for _ in range(10):
        state = model.step(state, model.control_for(state, torch.zeros(3).double(), asked))
    torch.testing.assert_close(state[:, 5] / state[:, 2], asked, rtol=0.05, atol=0)


@pytest.mark.parametrize("asked", [-20.0, -3.0, 0.0, 2.0, 20.0])
def test_tyres_hold_the_same_turn_whatever_the_controls_are(asked):
    """What is asked beside it is an acceleration, no wheel speed."""
    models = driven("motorcycle", 0.1), DiffGM3(load_vehicle("motorcycle")).double()
    state, one = riding(models[0], 8.0, 14.0), torch.ones(2).double()
    held = [each.curvature_within_grip(state, asked * one, one) for each in models]
    torch.testing.assert_close(*held)


@pytest.mark.parametrize("share", [0.0, 0.998, 1.002], ids=["locked", "slower", "faster"])
@pytest.mark.parametrize("name", ["bicycle", "scooter", "motorcycle", "cart"])
def test_wheels_have_the_load_that_their_driving_or_braking_leaves_on_them(name, share):
    """Brakes of other wheels take no load off it: they do nothing here."""
    model = driven(name, 0.002)  # short: the first moment, before the speeds are equal
    state, control = riding(model, 3.0), torch.zeros(1, len(model.Control._fields)).double()
    radii = [wheel.radius_m for wheel in model.spec.wheels if wheel.driven]
    control[0, :-1] = 3.0 * share / torch.tensor(radii)
    pushing = (model.step(state, control) - state)[0, 2] / 0.002
    places = torch.tensor(model.spec.per_wheel("x_m")).double()
    moment = (model.wheel_forces(state, control).normal_load * places).sum()
    pitching = -model.spec.mass_kg * model.spec.height_m * pushing
    assert torch.allclose(moment, pitching, rtol=0.05)  # the air brakes too


def test_a_full_stop_is_asked_for_with_a_gradient():
    model = driven("wheelchair", 0.1)
    asked = torch.zeros(1).double().requires_grad_()
    start = riding(model, 0.0).requires_grad_()
    model.control_for(start, asked, asked).sum().backward()
    assert start.grad.isfinite().all()
    assert asked.grad.isfinite().all()


def test_the_gradient_of_a_control_is_exact():
    model = driven("wheelchair", 0.1)
    given = [riding(model, 1.0), torch.full((1,), 0.3).double(), torch.full((1,), 0.2).double()]
    assert torch.autograd.gradcheck(
        model.control_for, [each.requires_grad_() for each in given], atol=1e-5
    )


@pytest.mark.parametrize("yaw_rate", [-0.6, 0.6])
@pytest.mark.parametrize("name", ["wheelchair", "hoverboard"])
def test_who_coasts_in_a_turn_drives_each_wheel_at_the_speed_of_its_hub(name, yaw_rate):
    model, none = driven(name, 0.1), torch.zeros(1).double()
    state = riding(model, 1.0)
    state[:, 5] = yaw_rate
    speeds = model.control_for_driver(state, DriverInput(none, none))[0, :-1].tolist()
    wheels = [wheel for wheel in model.spec.wheels if wheel.driven]
    expected = [(1.0 - yaw_rate * wheel.y_m) / wheel.radius_m for wheel in wheels]
    assert speeds == pytest.approx(expected)


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("name", ["bicycle", "wheelchair", "cart"])
def test_wheels_may_turn_as_fast_as_the_vehicle_may_go_and_back_if_it_does(
    name: str, reverse: bool
) -> None:
    spec = replace(load_vehicle(name), reverse=reverse)
    lower, upper = DiffGM3WheelSpeed(spec).double().bounds
    radii = torch.tensor([wheel.radius_m for wheel in spec.wheels if wheel.driven]).double()
    fastest = torch.full_like(radii, spec.limits.speed_max_mps)
    torch.testing.assert_close(upper[:-1] * radii, fastest)
    torch.testing.assert_close(lower[:-1] * radii, -fastest if reverse else 0 * fastest)
    of_other = DiffGM3(spec).double().bounds
    assert (lower[-1], upper[-1]) == (of_other.lower[-1], of_other.upper[-1])
