"""Drive models open loop under the same steps, whatever their states and controls."""

import csv
from functools import singledispatch
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.base import DynamicsModel
from diffstack_mmv.dynamics.gm3.model import DiffGM3
from diffstack_mmv.dynamics.gm3.wheel_forces import WheelForces, wheel_forces
from diffstack_mmv.dynamics.manoeuvres import Steps
from diffstack_mmv.dynamics.unicycle import ExtendedUnicycle
from diffstack_mmv.geometry import direction
from diffstack_mmv.types import Motion


class Run(NamedTuple):
    """What one model did: T + 1 states, T controls, and the motion of its centre of gravity."""

    states: Float[Tensor, "T1 n"]
    controls: Float[Tensor, "T m"]
    motion: Motion


@singledispatch
def control_of(
    model: DynamicsModel,
    state: Float[Tensor, " n"],
    step: Float[Tensor, "2"],
    wheelbase_m: float,
) -> Float[Tensor, " m"]:
    """Control of a model for a step (acceleration in m/s², angle of the front wheel in rad)."""
    return step


@control_of.register
def _(
    model: DiffGM3, state: Float[Tensor, " n"], step: Float[Tensor, "2"], wheelbase_m: float
) -> Float[Tensor, " m"]:
    # the angle is meant after the soft clamp
    return torch.stack([step[0], model.chassis.steering.command_for(step[1])])


@control_of.register
def _(
    model: ExtendedUnicycle,
    state: Float[Tensor, " n"],
    step: Float[Tensor, "2"],
    wheelbase_m: float,
) -> Float[Tensor, " m"]:
    speed = (state[3] + 0.5 * model.dt_s * step[0]).clamp_min(0)
    return torch.stack([speed * step[1].tan() / wheelbase_m, step[0]])


def _offset(model: DynamicsModel, rear_m: float) -> float:
    """Distance in m of the centre of gravity ahead of the model's reference point."""
    return 0.0 if isinstance(model, DiffGM3) else rear_m


def drive(
    model: DynamicsModel, steps: Steps, speed_mps: float, wheelbase_m: float, rear_m: float
) -> Run:
    """Drive a model from the origin, heading east, without gradients.

    Args:
        model: Any dynamics model; reference points other than the centre of gravity are taken to
            be the rear axle.
        steps: What the rider does.
        speed_mps: Speed at the start.
        wheelbase_m: Wheelbase, for a model that steers by a yaw rate.
        rear_m: Distance from the centre of gravity to the rear axle.
    """
    zero = torch.zeros((), dtype=steps.steer.dtype)
    ahead = _offset(model, rear_m)
    start = Motion(
        position=torch.stack([zero - ahead, zero]),
        heading=zero,
        velocity=torch.stack([zero + speed_mps, zero]),
        yaw_rate=zero,
    )
    states, controls = [model.initial_state(start)], []
    with torch.no_grad():
        for step in torch.stack(steps, -1):
            controls.append(control_of(model, states[-1], step, wheelbase_m))
            states.append(model(states[-1], controls[-1]))
        held = [*controls, controls[-1]]
        motion = model.motion(torch.stack(states), torch.stack(held))
    shifted = motion.position + ahead * direction(motion.heading)
    return Run(torch.stack(states), torch.stack(controls), motion._replace(position=shifted))


def wheel_history(model: DynamicsModel, run: Run) -> WheelForces | None:
    """What happened at the wheels, at the start of every step; None for a model without wheels."""
    if not isinstance(model, DiffGM3):
        return None
    with torch.no_grad():
        return wheel_forces(model, run.states[:-1], run.controls)


def save_run(path: Path, model: DynamicsModel, run: Run) -> None:
    """Write states and controls as CSV, one row per time, the last one without a control."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(path.name + ".part")
    with unfinished.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time_s", *model.State._fields, *model.Control._fields])
        blank = [""] * model.control_dim
        controls = [*run.controls.tolist(), blank]
        for index, (state, control) in enumerate(zip(run.states.tolist(), controls, strict=True)):
            writer.writerow([round(index * model.dt_s, 9), *state, *control])
    unfinished.replace(path)
