"""A whole identification: from recordings to identified and compared models."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import torch

from diffstack_mmv.checks import (
    message,
    require,
    require_at_least,
    require_columns,
    require_one_of,
    require_whole,
)
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification.inference.assumptions import TrackingAssumptions
from diffstack_mmv.identification.inference.comparison import (
    ModelBuilder,
    ModelComparison,
    ModelResult,
)
from diffstack_mmv.identification.inference.identification_problem import FittedMotion
from diffstack_mmv.identification.inference.identifier import Identifier
from diffstack_mmv.identification.inference.profile_likelihood import (
    ProfileLikelihood,
    profile_likelihoods,
)
from diffstack_mmv.identification.shooting.parameters import ParameterVector
from diffstack_mmv.identification.shooting.settings import TrackingSettings
from diffstack_mmv.identification.shooting.tracking_model import require_driven
from diffstack_mmv.identification.shooting.wheel_positions import (
    free_positions,
    with_uncertain_positions,
)
from diffstack_mmv.identification.tracks.cutting import Recordings, SegmentSettings, cut_tracks
from diffstack_mmv.identification.tracks.selection import ExcitationSelection, SegmentSelection
from diffstack_mmv.identification.tracks.splitting import (
    DataSplit,
    cross_validation_splits,
    split_segments,
)
from diffstack_mmv.vehicles import VehicleSpec

logger = logging.getLogger(__name__)

BEYOND_LIMITS = 0.25
"""Share of recorded controls beyond the limits of the vehicle from which on their unit is wrong."""


class StudyResult(NamedTuple):
    """What a study found; the first of the models is the one to identify."""

    models: Mapping[str, ModelResult]
    split: DataSplit
    settings: TrackingSettings
    profiles: Mapping[str, ProfileLikelihood]

    @property
    def identified(self) -> ModelResult:
        """The model to identify."""
        return next(iter(self.models.values()))

    def motions(self) -> list[FittedMotion]:
        """The fitted segments with the motions of the identified model."""
        problem, found, _ = self.identified
        return problem.fitted_motions(found)

    def calibrated(self, spec: VehicleSpec, source: str) -> VehicleSpec:
        """The vehicle with the estimates in the place of its priors.

        Args:
            spec: The vehicle.
            source: Where the new numbers come from.
        """
        problem, found, _ = self.identified
        return problem.calibrated(spec, found, source)


@dataclass(frozen=True)
class IdentificationStudy:
    """Identifies a model on segments of recorded tracks, and compares it with others.

    Args:
        spec: The vehicle.
        assumptions: Noise and regularisation, the same for every model.
        identifier: What identifies.
        segments: How tracks are cut.
        selection: Which segments to prefer.
        tracks: Number of segments to fit, at most.
        heldout: Number of segments to hold out, at most.
        seed: Of the random numbers.
        dt_s: Step of the tracks.
        folds: Number of folds of a cross-validation of all segments; none for 0.
        prediction_s: The end of a held-out segment that is predicted.
        parameters: Names of the parameters to learn; all learnable ones by default.
        profile: Names of the parameters whose profile likelihood is computed.

    Raises:
        ValueError: A number is too small, a count is not whole, segments or selection have another
            step, or `prediction_s` is too long for the segments.
    """

    spec: VehicleSpec
    assumptions: TrackingAssumptions
    identifier: Identifier = field(default_factory=Identifier)
    segments: SegmentSettings = SegmentSettings()
    selection: SegmentSelection = ExcitationSelection()
    tracks: int = 30
    heldout: int = 10
    seed: int = 0
    dt_s: float = 0.1
    folds: int = 0
    prediction_s: float = 1.0
    parameters: Sequence[str] | None = None
    profile: Sequence[str] = ()

    def __post_init__(self) -> None:
        require_at_least("tracks", self.tracks, 1)
        require_at_least("heldout", self.heldout, 1)
        for name in ("tracks", "heldout", "folds"):
            require_whole(name, getattr(self, name))
        steps = {"segments.dt_s": self.segments.dt_s}
        if isinstance(self.selection, ExcitationSelection):
            steps["selection.dt_s"] = self.selection.dt_s
        for name, step_s in steps.items():
            require(step_s == self.dt_s, name, f"be that of the study, {self.dt_s}", step_s)
        fits = self.folds == 0 or self.folds >= 2
        require(fits, "folds", "be 0 or at least 2", self.folds)
        require_at_least("prediction_s", self.prediction_s, self.dt_s)
        half_s = 0.5 * (self.segments.max_s + self.dt_s)
        needs, remedy = "be at most half of a segment", "Raise `max_s`, or predict less."
        told = f"{self.prediction_s} of {self.segments.max_s} s"
        require(self.prediction_s <= half_s, "prediction_s", needs, told, "", remedy)

    def __call__(self, recordings: Recordings, models: Mapping[str, ModelBuilder]) -> StudyResult:
        """Identify the first model, then the others, on the same segments.

        Args:
            recordings: The tracks.
            models: What builds each model, by its name.

        Raises:
            ValueError: No model is given, the recorded controls are not those of the first model
                or mostly beyond its limits, the tracks do not hold enough segments, a name of a
                parameter is unknown, or a model is driven by no acceleration.
            TypeError: A model stands where what builds one is asked for.
        """
        self.require_models(models)
        (name, build), *others = models.items()
        if self.assumptions.controls:
            _require_widths(recordings, build())
            _require_units(recordings, build())
        segments = cut_tracks(recordings, self.segments)
        split = split_segments(segments, self.selection, self.tracks, self.heldout, self.seed)
        folds = cross_validation_splits(split, self.folds, self.seed) if self.folds else ()
        settings = self.assumptions.settings(recordings, self.spec, split.fitted, self.dt_s)
        steps = round(self.prediction_s / self.dt_s)
        compare = ModelComparison(self.spec, split, settings, self.identifier, steps, folds)
        results = {name: compare(build, self.parameters)}
        results |= {
            other: compare(builder) for other, builder in others if self._comparable(builder())
        }
        problem, found, _ = results[name]
        method = self.identifier.method
        profiles = profile_likelihoods(problem.simulator, problem.data, found, method, self.profile)
        return StudyResult(results, split, problem.simulator.vehicle.settings, profiles)

    def require_models(self, models: Mapping[str, ModelBuilder]) -> None:
        """Refuse models that cannot be identified, before the work begins.

        Args:
            models: As for the study itself.

        Raises:
            ValueError: No model is given, one has another step or is driven by no acceleration, or
                the first has not the recorded controls or the parameters that are named.
            TypeError: A model stands where what builds one is asked for.
        """
        _require_builders(models)
        built = [build() for build in models.values()]
        for model in built:
            require_driven(model)
            require(
                model.dt_s == self.dt_s, "dt_s", f"be that of the model, {model.dt_s}", self.dt_s
            )
        self._require_names(built[0])

    def _require_names(self, model: DynamicsModel) -> None:
        """Refuse controls and parameters that the model does not have."""
        own, known = model.Control._fields, tuple(self.assumptions.controls or ())
        expected = f"name {', '.join(own)} in this order"
        require(not known or own == known, "controls", expected, ", ".join(known))
        free_positions(model, with_uncertain_positions(self.spec))
        learned = ParameterVector(model, self.spec, self.parameters).names
        for each in self.profile:
            require_one_of("profile", each, learned)

    def _comparable(self, model: DynamicsModel) -> bool:
        """Whether the recorded controls, if there are any, are those of a model."""
        own, known = model.Control._fields, tuple(self.assumptions.controls or ())
        if not known or own == known:
            return True
        logger.warning(
            "%s is not compared: its controls %s were not recorded", type(model).__name__, own
        )
        return False


def _require_builders(models: Mapping[str, object]) -> None:
    """Refuse no models, and those that are built already: each fit begins with a new one."""
    require(len(models) > 0, "models", "name at least one model", "none")
    for name, build in models.items():
        if isinstance(build, DynamicsModel) or not callable(build):
            found, remedy = type(build).__name__, "Write lambda: DiffKBM(spec)."
            raise TypeError(message(f"models[{name!r}]", "build a model", found, "", remedy))


def _require_widths(recordings: Recordings, model: DynamicsModel) -> None:
    """Refuse recorded controls of other columns than the model has."""
    own = model.Control._fields
    for name, controls in (recordings.controls or {}).items():
        require_columns(f"controls[{name!r}]", controls, len(own), own)


def _require_units(recordings: Recordings, model: DynamicsModel) -> None:
    """Refuse recorded controls that the vehicle cannot have had, as angles in degrees."""
    recorded = list((recordings.controls or {}).values())
    controls = torch.cat(recorded) if recorded else torch.empty(0)
    controls = controls[controls.isfinite().all(-1)]
    if len(controls) == 0:
        return
    limits = zip(model.Control._fields, *(bound.tolist() for bound in model.bounds), strict=True)
    for values, (name, low, high) in zip(controls.unbind(-1), limits, strict=True):
        beyond = int(((values < low) | (values > high)).sum())
        found = f"{beyond} of {len(values)} beyond, up to {float(values.abs().max()):.4g}"
        require(
            beyond <= BEYOND_LIMITS * len(values),
            f"controls.{name}",
            f"lie within the limits of the vehicle, {low:.4g} to {high:.4g}",
            found,
            remedy="Give rad and m/s², or widen the limits of the vehicle.",
        )
