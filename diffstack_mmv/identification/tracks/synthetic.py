"""Tracks of a known vehicle, to plan recordings and to prove that an identification is right."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from diffstack_mmv.checks import require, require_at_least, require_positive
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.dynamics.manoeuvres import Braking, Slalom, Turn
from diffstack_mmv.dynamics.open_loop import OpenLoopRun, drive
from diffstack_mmv.identification.tracks.instruments import recorded_controls
from diffstack_mmv.identification.tracks.segments import TrackSegment
from diffstack_mmv.vehicles import VehicleSpec

ExcitationManoeuvre = Slalom | Turn | Braking

RICH_MANOEUVRES: tuple[ExcitationManoeuvre, ...] = (
    Slalom(3.0, 0.30, 1.6, 3),
    Slalom(4.0, 0.22, 1.2, 4),
    Slalom(5.0, 0.17, 2.0, 2),
    Slalom(6.0, 0.12, 0.8, 6),
    Slalom(7.0, 0.09, 1.5, 3),
    Slalom(8.0, 0.07, 1.0, 5),
    Slalom(3.0, 0.12, 1.5, 2, 1.2),
    Slalom(9.0, 0.05, 1.5, 2, -2.5),
    Slalom(10.0, 0.03, 1.0, 2, -4.5),
    Turn(5.0, 2.0, 5.5, 0.4, 0.5),
    Turn(7.0, -1.6, 10.0, 0.5, 0.5),
    Turn(8.0, 1.6, 12.5, 0.6, 0.5),
    Turn(9.0, -1.2, 16.0, 0.4, 0.5),
    Turn(6.0, 1.8, 7.5, 0.3, 0.5, -0.8),
)
POOR_MANOEUVRES: tuple[ExcitationManoeuvre, ...] = (
    Slalom(2.0, 0.002, 4.0, 1),
    Slalom(2.5, 0.001, 2.0, 2),
    Slalom(3.0, 0.002, 4.0, 1),
)


@dataclass(frozen=True)
class MeasurementModel:
    """Noise of a measuring system.

    Args:
        position_m: Standard deviation of each coordinate of a position.
        controls: Standard deviation of each measured control, None if controls are not recorded.
        every: Steps of the vehicle per row: it moves in finer ones than it is recorded.

    Raises:
        ValueError: A number is not positive, or there is not at least one step per row.
    """

    position_m: float = 0.02
    controls: tuple[float, ...] | None = None
    every: int = 1

    def __post_init__(self) -> None:
        require_positive("position_m", self.position_m)
        require_at_least("every", self.every, 1)
        for deviation in self.controls or ():
            require_positive("controls", deviation)

    def record(
        self, name: str, model: DynamicsModel, run: OpenLoopRun, generator: Generator
    ) -> TrackSegment:
        """Record a run; course and speed, of which only the initial guess is made, are exact.

        Controls of a row are means over its steps.

        Args:
            name: Name of the segment.
            model: The vehicle.
            run: Its states and controls.
            generator: Of the noise.

        Raises:
            ValueError: The number of measured controls is not that of the model.
        """
        rows = len(run.controls) // self.every
        told = recorded_controls(model, run.states[:-1], run.controls)
        driven = told[: rows * self.every].unflatten(0, (rows, self.every)).mean(1)
        controls = torch.cat([driven, driven[-1:]])
        motion = model.motion(run.states[: rows * self.every + 1 : self.every], controls)
        noise = self.position_m * _normal(motion.position, generator)
        left, forward = motion.velocity[:, 1], motion.velocity[:, 0]
        measured = None
        if self.controls is not None:
            scale = controls.new_tensor(self.controls)
            require(len(scale) == controls.shape[-1], "controls", "fit the model", len(scale))
            measured = controls + scale * _normal(controls, generator)
        return TrackSegment(
            name,
            motion.position + noise,
            motion.heading + torch.atan2(left, forward),
            motion.velocity.norm(dim=-1),
            measured,
        )


def record_manoeuvres(
    model: DynamicsModel,
    spec: VehicleSpec,
    manoeuvres: Sequence[ExcitationManoeuvre],
    measurement: MeasurementModel,
    generator: Generator,
) -> list[TrackSegment]:
    """Drive manoeuvres and record them.

    Args:
        model: The vehicle as it is, in float64.
        spec: Its description.
        manoeuvres: Steps of the rider.
        measurement: Noise of the measuring system.
        generator: Of the noise.
    """
    wheelbase_m = spec.wheelbase.entries()[0][0]
    rows = []
    for index, manoeuvre in enumerate(manoeuvres):
        steps = manoeuvre(wheelbase_m, model.dt_s)
        run = drive(model, steps, manoeuvre.speed_mps)
        rows.append(measurement.record(f"manoeuvre_{index}@0.0s", model, run, generator))
    return rows


def _normal(like: Tensor, generator: Generator) -> Tensor:
    return torch.randn(like.shape, generator=generator, dtype=like.dtype)
