"""The result of a whole study under the keys of `identification.json`."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from diffstack_mmv.identification.inference.study import IdentificationStudy, StudyResult
from diffstack_mmv.identification.report.lean import lean_agreement
from diffstack_mmv.identification.report.remarks import lagging_alone, smoothed_beside_controls
from diffstack_mmv.identification.report.summary import summarise, tracking_losses
from diffstack_mmv.identification.tracks.cutting import Recordings
from diffstack_mmv.identification.tracks.excitation import share_beyond_limits

OF_THE_VEHICLE = ("tracks", "heldout_tracks", "smoother", "assumed", "fitted")


def identification_result(
    study: IdentificationStudy, recordings: Recordings, result: StudyResult
) -> dict[str, Any]:
    """Content of `identification.json` after its header.

    Args:
        study: The study.
        recordings: Its tracks.
        result: What it found.
    """
    problem, found, _ = result.identified
    used = [*result.split.fitted, *result.split.heldout]
    content = summarise(problem.simulator, problem.data, found, study.identifier.thresholds)
    tell = smoothed_beside_controls if recordings.controls else lagging_alone
    smoothed = tell(recordings.smoother)
    return content | {
        "remarks": content["remarks"] + smoothed,
        "models": {
            name: tracking_losses(each.problem.simulator, each.problem.data, each.identification)
            for name, each in result.models.items()
        },
        "validation": _validation(study, result),
        "assumed": asdict(result.settings),
        "beyond_limits": share_beyond_limits(used, study.spec.limits, study.dt_s),
        "profiles": {name: each._asdict() for name, each in result.profiles.items()},
        "lean": lean_agreement(result.motions(), study.dt_s),
        "smoother": recordings.smoother,
    }


def vehicle_provenance(
    header: Mapping[str, Any], content: Mapping[str, Any], model: str
) -> dict[str, Any]:
    """Where the numbers of a calibrated vehicle come from: what its file says.

    Args:
        header: Data, vehicle, model, seed and date.
        content: That of `identification.json`.
        model: Name of the identified model.
    """
    keys = (*OF_THE_VEHICLE, *content["models"][model])
    return {**header, **{key: content[key] for key in keys}}


def _validation(study: IdentificationStudy, result: StudyResult) -> dict[str, Any]:
    """Errors of all models on held-out segments, with the change from the identified model."""
    first = result.identified.validation
    return {
        "folds": study.folds,
        "stretches": len(first.names),
        "foresee_s": study.prediction_s,
        "models": {
            name: each.validation.pooled() | each.validation.change_from(first)
            for name, each in result.models.items()
        },
    }
