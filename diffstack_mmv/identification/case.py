"""A model with the tracks it has to explain, and what comes out of it."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification.fit import Data
from diffstack_mmv.identification.identify import Identification
from diffstack_mmv.identification.linearisation import Tracker
from diffstack_mmv.identification.parameters import LearnedParameters
from diffstack_mmv.identification.problem import TrackedVehicle, TrackingSettings
from diffstack_mmv.identification.stretches import Division, Stretch, batch
from diffstack_mmv.vehicles import VehicleSpec


class Explained(NamedTuple):
    """One stretch and the motion that explains it."""

    stretch: Stretch
    position: Float[Tensor, "T1 2"]  # m
    controls: Float[Tensor, "T m"]
    lean: Float[Tensor, " T1"] | None  # rad, where the model has one


class Case(NamedTuple):
    """A model and its tracking problems, in float64."""

    tracker: Tracker
    data: Data
    division: Division

    @classmethod
    def of(
        cls,
        model: DynamicsModel,
        spec: VehicleSpec,
        division: Division,
        settings: TrackingSettings,
        parameters: Sequence[str] | None = None,
    ) -> "Case":
        """Set up the problem of a model.

        Args:
            model: The dynamics.
            spec: The vehicle it was built from.
            division: Stretches to fit and to hold out.
            settings: Noise and regularisation.
            parameters: Names of the parameters that may move; all learnable ones by default.

        Raises:
            ValueError: A name is unknown, or a physical model has nothing to learn.
        """
        model = model.double()
        learned = LearnedParameters(model, spec, parameters)
        require(
            len(learned) > 0 or not model.physical_parameters(),
            "vehicle",
            "have parameters marked `learn: true` with a range",
            f"'{spec.name}' without any",
            f"for {type(model).__name__}",
            "Mark some in its YAML file.",
        )
        vehicle = TrackedVehicle(model, settings).double()
        data = Data(
            vehicle.problem(batch(division.fitted)), vehicle.problem(batch(division.heldout))
        )
        return cls(Tracker(vehicle, learned), data, division)

    def calibrated(self, spec: VehicleSpec, found: Identification, source: str) -> VehicleSpec:
        """The vehicle with the estimates in the place of its priors.

        Args:
            spec: The vehicle.
            found: The identification.
            source: Where the new numbers come from.
        """
        values = self.tracker.parameters.calibrated(found.after.theta)
        moved = {
            name.split(".")[0]
            for name, active in zip(
                self.tracker.parameters.names, found.active.tolist(), strict=True
            )
            if active
        }
        return spec.with_values({n: v for n, v in values.items() if n in moved}, source)

    def explained(self, found: Identification) -> list[Explained]:
        """Each fitted stretch with the motion, the controls and the lean that explain it."""
        vehicle = self.tracker.vehicle
        states = found.after.fitted.simulated.states
        plain, _, _ = vehicle.split(states)
        # the control of a step stands in the state after it
        control = states[:, 1:, -vehicle.model.control_dim :]
        position = vehicle.model.motion(plain, states[..., -vehicle.model.control_dim :]).position
        columns = vehicle.model.State._fields
        lean = plain[..., columns.index("lean")] if "lean" in columns else None
        rows = []
        for index, stretch in enumerate(self.division.fitted):
            end = len(stretch.speed)
            own = None if lean is None else lean[index, :end]
            rows.append(Explained(stretch, position[index, :end], control[index, : end - 1], own))
        return rows


def lean_agreement(
    rows: Sequence[Explained], dt_s: float, longest_lag_s: float = 1.0
) -> Mapping[str, Any] | None:
    """Agreement of the model's lean with the measured one, which no fit has seen.

    Args:
        rows: Stretches and their explanations.
        dt_s: Step of the tracks.
        longest_lag_s: How late the model's lean is looked for.

    Returns:
        Root mean square difference in rad, correlation, number of samples; by how much the model's
        lean comes late (s) where it fits best, with the correlation there. None without both.
    """
    pairs = [
        (row.lean, row.stretch.lean)
        for row in rows
        if row.lean is not None and row.stretch.lean is not None
    ]
    if not pairs:
        return None
    model, measured = _overlapping(pairs, 0)
    lags = range(round(longest_lag_s / dt_s) + 1)
    by_lag = [float(_correlation(*_overlapping(pairs, lag))) for lag in lags]
    best = max(lags, key=by_lag.__getitem__)
    return {
        "rms_difference_rad": float((model - measured).square().mean().sqrt()),
        "rms_measured_rad": float(measured.square().mean().sqrt()),
        "correlation": by_lag[0],
        "samples": len(measured),
        "late_s": best * dt_s,
        "correlation_late": by_lag[best],
    }


def _overlapping(pairs: Sequence[tuple[Tensor, Tensor]], lag: int) -> tuple[Tensor, Tensor]:
    """All samples of the model, and of the measurement `lag` steps before, where there is one."""
    model = torch.cat([own[lag:] for own, _ in pairs])
    measured = torch.cat([other[: len(other) - lag] for _, other in pairs])
    known = measured.isfinite()
    return model[known], measured[known]


def _correlation(first: Tensor, second: Tensor) -> Tensor:
    return torch.corrcoef(torch.stack([first, second]))[0, 1]
