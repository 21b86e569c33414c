"""A model with the tracks it is identified on, and the motions it was fitted to."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification.inference.identifier import Identification
from diffstack_mmv.identification.shooting.fit import EstimationData
from diffstack_mmv.identification.shooting.linearisation import TrackSimulator
from diffstack_mmv.identification.shooting.parameters import ParameterVector
from diffstack_mmv.identification.shooting.settings import TrackingSettings
from diffstack_mmv.identification.shooting.tracking_model import TrackingModel
from diffstack_mmv.identification.shooting.wheel_positions import (
    LENGTH_SCALE,
    free_positions,
    with_uncertain_positions,
)
from diffstack_mmv.identification.tracks.segments import TrackSegment, stack_segments
from diffstack_mmv.identification.tracks.splitting import DataSplit
from diffstack_mmv.vehicles import VehicleSpec


class FittedMotion(NamedTuple):
    """One segment and the motion of the model that was fitted to it."""

    segment: TrackSegment
    position: Float[Tensor, "T1 2"]  # m
    controls: Float[Tensor, "T m"]
    lean: Float[Tensor, " T1"] | None  # rad, where the model has one

    def arrays(self) -> dict[str, Any]:
        """Name and arrays of `plotting.FittedTrack` by its fields."""
        lean, recorded_lean = (
            each if each is None else each.numpy() for each in (self.lean, self.segment.lean)
        )
        return {
            "name": self.segment.name,
            "recorded": self.segment.position.numpy(),
            "fitted": self.position.numpy(),
            "controls": self.controls.numpy(),
            "lean": lean,
            "recorded_lean": recorded_lean,
        }


class IdentificationProblem(NamedTuple):
    """A model and its tracking problems, in float64."""

    simulator: TrackSimulator
    data: EstimationData
    split: DataSplit

    @classmethod
    def of(
        cls,
        model: DynamicsModel,
        spec: VehicleSpec,
        split: DataSplit,
        settings: TrackingSettings,
        parameters: Sequence[str] | None = None,
    ) -> "IdentificationProblem":
        """Set up the problem of a model.

        Args:
            model: The dynamics.
            spec: The vehicle it was built from.
            split: Segments to fit and to hold out.
            settings: Noise and regularisation.
            parameters: Names of the parameters to learn; all learnable ones by default.

        Raises:
            ValueError: A name is unknown, or a physical model has nothing to learn.
        """
        spec = with_uncertain_positions(spec)
        free_positions(model, spec)
        model = model.double()
        learned = ParameterVector(model, spec, parameters)
        require(
            len(learned) > 0 or not model.physical_parameters(),
            "vehicle",
            "have parameters marked `learn: true` with a range",
            f"'{spec.name}' without any",
            f"for {type(model).__name__}",
            "Mark some in its YAML file.",
        )
        vehicle = TrackingModel(model, settings).double()
        data = EstimationData(
            vehicle.problem(stack_segments(split.fitted)),
            vehicle.problem(stack_segments(split.heldout)),
        )
        return cls(TrackSimulator(vehicle, learned), data, split)

    def calibrated(self, spec: VehicleSpec, found: Identification, source: str) -> VehicleSpec:
        """The vehicle with the estimates in the place of its priors.

        Args:
            spec: The vehicle.
            found: The identification.
            source: Where the new numbers come from.
        """
        values = self.simulator.parameters.calibrated(found.after.theta)
        moved = {
            name.split(".")[0]
            for name, active in zip(
                self.simulator.parameters.names, found.active.tolist(), strict=True
            )
            if active
        }
        moved_values = {n: v for n, v in values.items() if n in moved}
        vehicle = with_uncertain_positions(spec) if LENGTH_SCALE in moved else spec
        return vehicle.with_values(moved_values, source)

    def fitted_motions(self, found: Identification) -> list[FittedMotion]:
        """Each fitted segment with the motion, the controls and the lean of the fit."""
        vehicle = self.simulator.vehicle
        states = found.after.fitted.simulated.states
        plain, _, _ = vehicle.split(states)
        # the control of a step is stored in the state after it
        control = states[:, 1:, -vehicle.model.control_dim :]
        position = vehicle.model.motion(plain, states[..., -vehicle.model.control_dim :]).position
        columns = vehicle.model.State._fields
        lean = plain[..., columns.index("lean")] if "lean" in columns else None
        rows = []
        for index, segment in enumerate(self.split.fitted):
            end = len(segment.speed)
            own = None if lean is None else lean[index, :end]
            rows.append(
                FittedMotion(segment, position[index, :end], control[index, : end - 1], own)
            )
        return rows
