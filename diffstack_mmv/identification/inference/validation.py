"""Validation: how well a model describes tracks that its parameters were not fitted to.

The tracking error, the distance between a track and its fit, is mostly noise of the recording, of
which every model with free controls follows the same share. The prediction error is free of that:
controls are inferred from the first part of a track only, and the rider's command stays constant
after it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require
from diffstack_mmv.identification.inference.identification_problem import IdentificationProblem
from diffstack_mmv.identification.inference.identifier import Identification, Identifier
from diffstack_mmv.identification.shooting.problem import TrackingProblem
from diffstack_mmv.identification.shooting.tracking import infer_controls, position_error


class ValidationErrors(NamedTuple):
    """Errors on segments that were held out, one entry per segment."""

    names: tuple[str, ...]
    tracking: Float[Tensor, " N"]  # m, root mean square distance of the fit
    samples: Float[Tensor, " N"]
    prediction: Float[Tensor, " N"]  # m, root mean square distance where the command is constant

    def pooled(self) -> dict[str, float]:
        """Root mean squares over all segments in m, by their keys in `identification.json`."""
        squares = (self.tracking.square() * self.samples).sum() / self.samples.sum()
        return {
            "followed": float(squares.sqrt()),
            "foreseen": float(self.prediction.square().mean().sqrt()),
        }

    def change_from(self, other: "ValidationErrors") -> dict[str, float | None]:
        """Mean difference to the errors of another model on the same segments, in m.

        Returns:
            For both errors the mean difference and its standard error over the segments, None for
            a single segment.
        """
        changes = {
            "followed": self.tracking - other.tracking,
            "foreseen": self.prediction - other.prediction,
        }
        result: dict[str, float | None] = {}
        for name, change in changes.items():
            result[f"{name}_change"] = float(change.mean())
            several = len(change) > 1
            result[f"{name}_change_std"] = (
                float(change.std() / len(change) ** 0.5) if several else None
            )
        return result


def drop_last_samples(problem: TrackingProblem, steps: int) -> TrackingProblem:
    """The problem with zero weight of the last samples of each track, and of what led to them.

    Args:
        problem: The tracks.
        steps: How many samples to leave out.

    Raises:
        ValueError: A track would be left with fewer samples than are left out.
    """
    weight = problem.measurements.weight
    lengths = weight.sum(-1, keepdim=True)
    shortest = int(lengths.min())
    remedy = "Take longer segments or predict less."
    require(shortest >= 2 * steps, "tracks", f"have {2 * steps} samples", shortest, "", remedy)
    stage = torch.arange(weight.shape[1])
    # the control beside the last sample that is kept acts after it
    acting = stage < lengths - steps - 1
    measurements = problem.measurements._replace(
        weight=weight * (stage < lengths - steps),
        control_weight=problem.measurements.control_weight * acting.unsqueeze(-1),
    )
    return problem._replace(measurements=measurements)


def validation_errors(
    problem: IdentificationProblem, found: Identification, identifier: Identifier, steps: int
) -> ValidationErrors:
    """Errors on the held-out segments of a problem.

    Args:
        problem: Model and tracks.
        found: Its identification.
        identifier: What infers the controls.
        steps: How many samples at the end of a segment are predicted.

    Raises:
        ValueError: A held-out segment is too short for that.
    """
    simulator, heldout = problem.simulator, problem.data.heldout
    early = drop_last_samples(heldout, steps)
    states = found.after.heldout.simulated.states
    with torch.no_grad():
        whole = position_error(simulator, states, heldout.measurements)
        start = infer_controls(
            simulator, found.after.theta, early, heldout.guess, identifier.tracking
        )
        ahead = position_error(simulator, start.simulated.states, heldout.measurements)
    ahead = ahead * (early.measurements.weight == 0)
    samples = heldout.measurements.weight.sum(-1)
    return ValidationErrors(
        tuple(segment.name for segment in problem.split.heldout),
        (whole.square().sum(-1) / samples).sqrt(),
        samples,
        (ahead.square().sum(-1) / steps).sqrt(),
    )


def concatenate_errors(parts: Sequence[ValidationErrors]) -> ValidationErrors:
    """Errors of several parts in one record, in the order of the segments' names."""
    names = [name for part in parts for name in part.names]
    order = sorted(range(len(names)), key=names.__getitem__)
    columns = [torch.cat(column)[order] for column in zip(*(p[1:] for p in parts), strict=True)]
    return ValidationErrors(tuple(names[index] for index in order), *columns)
