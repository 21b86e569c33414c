"""Several models identified and validated on the same segments."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification.inference.identification_problem import IdentificationProblem
from diffstack_mmv.identification.inference.identifier import Identification, Identifier
from diffstack_mmv.identification.inference.validation import (
    ValidationErrors,
    concatenate_errors,
    validation_errors,
)
from diffstack_mmv.identification.shooting.fit import total_cost
from diffstack_mmv.identification.shooting.settings import TrackingSettings
from diffstack_mmv.identification.tracks.splitting import DataSplit
from diffstack_mmv.vehicles import VehicleSpec

ModelBuilder = Callable[[], DynamicsModel]

EVIDENCE_NATS = 10.0
"""By how much tracks have to speak for a simulation: what is recorded is a vehicle, as a rule."""


class ModelResult(NamedTuple):
    """A model with its tracks, its identification, and its errors on held-out segments."""

    problem: IdentificationProblem
    identification: Identification
    validation: ValidationErrors


@dataclass(frozen=True)
class ModelComparison:
    """Identifies and validates models on the same segments, one per call.

    Args:
        spec: The vehicle.
        split: Segments to fit and to hold out.
        settings: Noise and regularisation, the same for every model; whether recorded controls are
            a model's own steps is found for each.
        identifier: What identifies.
        prediction_steps: How many samples at the end of a segment are predicted.
        folds: Splits to validate on in turn; on `split` alone if there are none.
    """

    spec: VehicleSpec
    split: DataSplit
    settings: TrackingSettings
    identifier: Identifier
    prediction_steps: int = 10
    folds: Sequence[DataSplit] = ()

    def __call__(self, build: ModelBuilder, parameters: Sequence[str] | None = None) -> ModelResult:
        """Identify a model on the split, and validate it on what is held out.

        Args:
            build: Builds the model anew.
            parameters: Names of the parameters to learn; all learnable ones by default.

        Raises:
            ValueError: A held-out segment is too short, a name is unknown, or a physical model has
                nothing to learn.
        """
        settings = self._settings(build, parameters)
        identified = self._identified(build, parameters, self.split, settings, self.identifier)
        folds = [
            self._identified(build, parameters, fold, settings, self._once) for fold in self.folds
        ]
        errors = [
            validation_errors(*part, self.identifier, self.prediction_steps)
            for part in folds or [identified]
        ]
        return ModelResult(*identified, concatenate_errors(errors))

    @property
    def _once(self) -> Identifier:
        """Without other optima, which widen deviations, and hardly change errors."""
        return replace(self.identifier, starts=0)

    def _settings(self, build: ModelBuilder, parameters: Sequence[str] | None) -> TrackingSettings:
        """The settings, with recorded controls taken for the model's own where that fits better."""
        if self.settings.control_noise is None or not build().acts_a_step_late:
            return self.settings
        own = replace(self.settings, own_steps=True)
        gain = self._cost(build, parameters, self.settings) - self._cost(build, parameters, own)
        return own if gain > EVIDENCE_NATS else self.settings

    def _cost(
        self, build: ModelBuilder, parameters: Sequence[str] | None, settings: TrackingSettings
    ) -> float:
        problem, found = self._identified(build, parameters, self.split, settings, self._once)
        return total_cost(problem.simulator, found.after)

    def _identified(
        self,
        build: ModelBuilder,
        parameters: Sequence[str] | None,
        split: DataSplit,
        settings: TrackingSettings,
        identifier: Identifier,
    ) -> tuple[IdentificationProblem, Identification]:
        problem = IdentificationProblem.of(build(), self.spec, split, settings, parameters)
        return problem, identifier(problem.simulator, problem.data)
