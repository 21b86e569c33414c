"""Drive models open loop under the same inputs, whatever their states and controls."""

import csv
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import message
from diffstack_mmv.dynamics.base import DynamicsModel
from diffstack_mmv.dynamics.records import DriverInput, WheelForces
from diffstack_mmv.geometry import direction
from diffstack_mmv.types import Motion
from dmmv_conventions.disk import replacing


class OpenLoopRun(NamedTuple):
    """What one model did: T + 1 states, T controls, and the motion of its centre of gravity."""

    states: Float[Tensor, "T1 n"]
    controls: Float[Tensor, "T m"]
    motion: Motion
    lean: Float[Tensor, " T1"] | None  # rad, where the model has one


def drive(model: DynamicsModel, inputs: DriverInput, speed_mps: float) -> OpenLoopRun:
    """Drive a model with its centre of gravity at the origin, heading east.

    Args:
        model: Any dynamics model that a driver can steer.
        inputs: What the driver does, one row per step.
        speed_mps: Speed at the start.

    Returns:
        States, controls and motion, without gradients.

    Raises:
        ValueError: The model does not say what a steering angle does, or its states do not stay
            finite.
    """
    zero = torch.zeros((), dtype=inputs.steer.dtype)
    ahead = -model.reference_ahead_m
    start = Motion(
        position=torch.stack([zero - ahead, zero]),
        heading=zero,
        velocity=torch.stack([zero + speed_mps, zero]),
        yaw_rate=zero,
    )
    states, controls = [model.initial_state(start)], []
    with torch.no_grad():
        for step in zip(*inputs, strict=True):
            controls.append(model.control_for_driver(states[-1], DriverInput(*step)))
            states.append(model(states[-1], controls[-1]))
        held = [*controls, controls[-1]]
        motion = model.motion(torch.stack(states), torch.stack(held))
    shifted = motion.position + ahead * direction(motion.heading)
    columns, whole = model.State._fields, torch.stack(states)
    _require_finite(model, whole)
    lean = whole[:, columns.index("lean")] if "lean" in columns else None
    return OpenLoopRun(whole, torch.stack(controls), motion._replace(position=shifted), lean)


def _require_finite(model: DynamicsModel, states: Float[Tensor, "T1 n"]) -> None:
    """Refuse a drive of which nothing could be drawn."""
    bad = (~states.isfinite()).nonzero()
    if len(bad):
        row, column = bad[0].tolist()
        found = f"{model.State._fields[column]} = {float(states[row, column])}"
        where = f"after {row * model.dt_s:g} s with {type(model).__name__}"
        raise ValueError(message("states", "stay finite", found, where, "Look at its `step`."))


def wheel_history(model: DynamicsModel, run: OpenLoopRun) -> WheelForces | None:
    """What happened at the wheels, at the start of every step; None for a model without wheels."""
    with torch.no_grad():
        return model.wheel_forces(run.states[:-1], run.controls)


def save_run(path: Path, model: DynamicsModel, run: OpenLoopRun) -> None:
    """Write states and controls as CSV, one row per time, the last one without a control."""
    with replacing(path) as unfinished, unfinished.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time_s", *model.State._fields, *model.Control._fields])
        blank = [""] * model.control_dim
        controls = [*run.controls.tolist(), blank]
        for index, (state, control) in enumerate(zip(run.states.tolist(), controls, strict=True)):
            writer.writerow([round(index * model.dt_s, 9), *state, *control])
