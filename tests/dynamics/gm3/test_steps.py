"""The step of the velocities, and the wheels that it looks at, against what they stand for."""

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3
from diffstack_mmv.dynamics.gm3.body import LinearEquation, factored, outer_sum, times
from diffstack_mmv.dynamics.gm3.slip import (
    WheelVelocity,
    hub_velocity,
    slip_angle_ratio,
    wheel_axes,
)
from diffstack_mmv.dynamics.gm3.stepper import pade_step
from diffstack_mmv.geometry import rotate
from diffstack_mmv.vehicles import load_vehicle

COUNT = 9


def drawn(*shape):
    return torch.randn(*shape, COUNT, dtype=torch.float64)


def dissipative(rate=1.0):
    """v' = A v + b with A + A' negative definite, as the tyres make it."""
    root, turn = drawn(3, 3), drawn(3, 3)
    loss = torch.einsum("xyn,zyn->xzn", root, root) + 0.1 * torch.eye(3).double().unsqueeze(-1)
    return LinearEquation(rate * (turn - turn.transpose(0, 1) - loss), rate * drawn(3))


def exact(equation, velocity, step_s):
    """The solution by the matrix exponential."""
    whole = torch.zeros(COUNT, 4, 4, dtype=torch.float64)
    whole[:, :3, :3] = equation.matrix.movedim(-1, 0)
    whole[:, :3, 3] = equation.offset.mT
    start = torch.cat([velocity, torch.ones(1, COUNT).double()]).mT.unsqueeze(-1)
    return (torch.linalg.matrix_exp(step_s * whole) @ start).squeeze(-1)[:, :3].mT


def test_the_step_is_of_second_order():
    equation, velocity = dissipative(), drawn(3)
    apart = [
        (pade_step(equation, velocity, step_s).end - exact(equation, velocity, step_s)).norm()
        for step_s in (0.01, 0.005)
    ]
    assert apart[0] / apart[1] == pytest.approx(8.0, rel=0.1)


@pytest.mark.parametrize("name", ["bicycle", "tricycle", "wheelchair", "cart", "skateboard"])
def test_a_vehicle_is_stepped_with_an_error_of_second_order(name):
    spec = load_vehicle(name)
    start = torch.tensor([[0.0, 0.0, 3.0, 0.05, 0.3, 0.3, 0.02 * spec.leans, 0.0]]).double()
    control = torch.tensor([[-1.0, 0.1]]).double()
    with torch.no_grad():
        ends = [
            DiffGM3(spec, 0.4, substeps=count).double()(start, control) for count in (64, 128, 256)
        ]
    ratio = (ends[0] - ends[1]).norm() / (ends[1] - ends[2]).norm()
    assert 3.4 < ratio < 4.6  # 2 if of first order


@pytest.mark.parametrize("parts", [1, 2, 5])
def test_the_mean_of_a_step_is_what_its_change_is_made_of(parts):
    equation, velocity = dissipative(), drawn(3)
    step = pade_step(equation, velocity, 0.1, parts)
    torch.testing.assert_close(step.end - velocity, 0.1 * equation.rate(step.mean))


@pytest.mark.parametrize("rate", [1.0, 1e2, 1e4, 1e8])
def test_an_equilibrium_is_kept_and_what_is_far_from_it_comes_nearer(rate):
    equation = dissipative(rate)
    rest = -factored(equation.matrix).solve(equation.offset)
    torch.testing.assert_close(pade_step(equation, rest, 0.1).end, rest)
    away = drawn(3)
    left = pade_step(equation, rest + away, 0.1).end - rest
    assert (left.norm(dim=0) < away.norm(dim=0)).all()


def test_fast_rates_are_over_within_a_step():
    equation, away = dissipative(1e6), drawn(3)
    rest = -factored(equation.matrix).solve(equation.offset)
    left = pade_step(equation, rest + away, 0.1).end - rest
    assert (left.norm(dim=0) < 1e-6 * away.norm(dim=0)).all()


def test_a_factored_matrix_solves_as_a_library_does():
    matrix, vector = dissipative().matrix, drawn(3)
    found = factored(matrix).solve(vector)
    torch.testing.assert_close(times(matrix, found), vector)
    expected = torch.linalg.solve(matrix.movedim(-1, 0), vector.mT)
    torch.testing.assert_close(found.mT, expected)


def wheels():
    x, y = torch.tensor([[0.6, -0.5, -0.5], [0.0, 0.3, -0.3]]).double().unsqueeze(-1)
    angle = drawn(3)
    return x, y, angle, wheel_axes(x, y, angle.sin(), angle.cos())


def test_hubs_move_as_points_of_a_rigid_body_seen_along_the_wheel():
    x, y, angle, axes = wheels()
    forward, left, yaw_rate = velocity = drawn(3)
    of_point = torch.stack([forward - yaw_rate * y, left + yaw_rate * x], -1)
    seen = rotate(of_point, -angle)
    hub = hub_velocity(axes, velocity)
    torch.testing.assert_close(torch.stack(hub, -1), seen)


def test_forces_at_the_wheels_do_the_work_that_they_do_on_the_body():
    *_, axes = wheels()
    velocity, along, across = drawn(3), drawn(3), drawn(3)
    hub = hub_velocity(axes, velocity)
    at_wheels = (along * hub.forward + across * hub.left).sum(0)
    on_body = ((axes.along * along + axes.across * across).sum(1) * velocity).sum(0)
    torch.testing.assert_close(at_wheels, on_body)


def test_a_sum_of_dampers_at_the_wheels_is_symmetric_and_never_drives():
    *_, axes = wheels()
    gain = torch.rand(3, COUNT, dtype=torch.float64)
    damper = outer_sum(axes.across, gain * axes.across)
    torch.testing.assert_close(damper, damper.transpose(0, 1))
    velocity = drawn(3)
    assert ((velocity * times(damper, velocity)).sum(0) >= 0).all()


@pytest.mark.parametrize("speed", [0.0, 1e-6, 0.1, 5.0, -5.0])
def test_the_slip_angle_is_that_of_the_hub_and_finite_without_slip(speed):
    left = torch.cat([drawn(2), torch.zeros(1, COUNT).double()])
    ratio = slip_angle_ratio(WheelVelocity(torch.full_like(left, speed), left), 0.1)
    angle = torch.atan2(-left, torch.tensor(speed**2 + 0.1**2).double().sqrt())
    torch.testing.assert_close(-left * ratio, angle)
    assert ratio.isfinite().all()
