"""Random constrained drives: a bicycle between moving discs, with limits on speed and grip."""

from typing import NamedTuple

import torch
from torch import Tensor

from diffstack_mmv.control import Batched, Bounds
from diffstack_mmv.control.constrained import Inequality

DT = 0.1
BOX = ((-4.0, -0.6), (4.0, 0.6))  # m/s², rad


class Drive(NamedTuple):
    """What defines a batch of drives, one entry per problem."""

    state: Tensor  # x, y, heading, speed
    goal: Tensor  # 2, m
    centre: Tensor  # N 2, m
    velocity: Tensor  # N 2, m/s
    radius: Tensor  # N, m
    top_speed: Tensor  # m/s
    grip: Tensor  # m/s², radius of the friction circle
    weight: Tensor  # 3: goal, speed, effort
    wheelbase: Tensor  # m


def step(state, control, wheelbase):
    x, y, heading, speed = state.unbind(-1)
    acceleration, steer = control.unbind(-1)
    rates = [speed * heading.cos(), speed * heading.sin(), speed / wheelbase * steer.tan()]
    return state + DT * torch.stack([*rates, acceleration], -1)


def price(states, controls, goal, weight):
    near, slow, effort = (weight[..., i].unsqueeze(-1) for i in range(3))
    distance = (states[..., :2] - goal.unsqueeze(-2)).square().sum(-1)
    return (
        near * distance
        + slow * (states[..., 3] - 2).square()
        + effort * (0.2 * controls[..., 0].square() + controls[..., 1].square())
    )


def overlap(states, controls, centre, velocity, radius):
    """1 - (distance / radius)² of each disc at each time."""
    time = DT * torch.arange(states.shape[-2], dtype=states.dtype).unsqueeze(-1)
    away = states[..., :2].unsqueeze(-3) - (centre.unsqueeze(-2) + velocity.unsqueeze(-2) * time)
    return (1 - away.square().sum(-1) / radius.square().unsqueeze(-1)).transpose(-1, -2)


def speeding(states, controls, top_speed):
    return states[..., 3:] - top_speed[..., None, None]


def skidding(states, controls, wheelbase, grip):
    """(a² + (v² tan δ / L)²) / grip² - 1."""
    turning = states[..., 3].square() * controls[..., 1].tan() / wheelbase.unsqueeze(-1)
    demand = controls[..., 0].square() + turning.square()
    return (demand / grip.square().unsqueeze(-1) - 1).unsqueeze(-1)


def drives(count, discs=3, seed=0):
    """Drives whose straight way is often barred."""
    generator = torch.Generator().manual_seed(seed)

    def between(low, high, *shape):
        draw = torch.rand(count, *shape, generator=generator, dtype=torch.get_default_dtype())
        return low + (high - low) * draw

    goal = torch.stack([between(4, 8), between(-2, 2)], -1)
    share = between(0.3, 1.0, discs)
    centre = share.unsqueeze(-1) * goal.unsqueeze(1) + between(-1, 1, discs, 2)
    zero = torch.zeros_like(share[:, 0])
    return Drive(
        torch.stack([zero, zero, between(-0.5, 0.5), between(0.5, 2.5)], -1),
        goal,
        centre,
        between(-0.3, 0.3, discs, 2),
        between(0.3, 0.8, discs),
        between(2.6, 3.5),
        between(2.0, 4.0),
        torch.stack([between(0.1, 0.5), between(0.05, 0.2), between(0.05, 0.2)], -1),
        between(0.8, 1.5),
    )


def box():
    return Bounds(*(torch.tensor(side) for side in BOX))


def constraints(drive):
    """Clearance and speed from the second time on, grip at every time that has a control."""
    later = slice(1, None)
    return [
        Inequality(Batched(overlap, drive.centre, drive.velocity, drive.radius), times=later),
        Inequality(Batched(speeding, drive.top_speed), times=later),
        Inequality(Batched(skidding, drive.wheelbase, drive.grip), times=slice(-1)),
    ]


def solve(solver, drive, controls, multipliers=None, wanted=constraints):
    """Solve a batch of drives."""
    dynamics = Batched(step, drive.wheelbase)
    cost = Batched(price, drive.goal, drive.weight)
    return solver(dynamics, cost, wanted(drive), box(), drive.state, controls, multipliers)


def braking(drive, steps=30, rate=2.0):
    """Controls that bring the vehicle to a standstill: a guess that is seldom in anything's way."""
    speed = drive.state[..., 3:] - rate * DT * torch.arange(steps, dtype=drive.state.dtype)
    slower = -(speed / DT).clamp(0, rate)
    return torch.stack([slower, torch.zeros_like(slower)], -1)
