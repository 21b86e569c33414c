"""How well a model follows tracks that its parameters were not fitted to.

The distance between a track and its fit is mostly noise of the recording, of which every model
with free controls follows the same share. What a model foresees is free of that: controls are
inferred from the first part of a track only, and the rider's intention is held after it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from diffstack_mmv.checks import require, require_at_least
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification.case import Case
from diffstack_mmv.identification.identify import Identification, Identifier
from diffstack_mmv.identification.problem import Problem, TrackingSettings
from diffstack_mmv.identification.stretches import Division
from diffstack_mmv.identification.tracking import position_error, track
from diffstack_mmv.vehicles import VehicleSpec


class HeldOut(NamedTuple):
    """Errors on stretches that were held out, one entry per stretch."""

    names: tuple[str, ...]
    followed: Float[Tensor, " N"]  # m, root mean square distance of the fit
    samples: Float[Tensor, " N"]
    foreseen: Float[Tensor, " N"]  # m, root mean square distance where controls are held

    def pooled(self) -> dict[str, float]:
        """Root mean squares over all stretches in m."""
        squares = (self.followed.square() * self.samples).sum() / self.samples.sum()
        return {
            "followed": float(squares.sqrt()),
            "foreseen": float(self.foreseen.square().mean().sqrt()),
        }

    def change_from(self, other: "HeldOut") -> dict[str, float | None]:
        """Mean difference to the errors of another model on the same stretches, in m.

        Returns:
            For both errors the mean difference and its standard error over the stretches, None for
            a single stretch.
        """
        told: dict[str, float | None] = {}
        for name in ("followed", "foreseen"):
            change = getattr(self, name) - getattr(other, name)
            told[f"{name}_change"] = float(change.mean())
            several = len(change) > 1
            told[f"{name}_change_std"] = (
                float(change.std() / len(change) ** 0.5) if several else None
            )
        return told


def cut_short(problem: Problem, steps: int) -> Problem:
    """The problem without the last samples of each track: they weigh nothing.

    Args:
        problem: The tracks.
        steps: How many samples to leave out.

    Raises:
        ValueError: A track would be left with fewer samples than are left out.
    """
    weight = problem.targets.weight
    lengths = weight.sum(-1, keepdim=True)
    shortest = int(lengths.min())
    remedy = "Take longer stretches or foresee less."
    require(shortest >= 2 * steps, "tracks", f"have {2 * steps} samples", shortest, "", remedy)
    kept = torch.arange(weight.shape[1]) < lengths - steps
    targets = problem.targets._replace(
        weight=weight * kept,
        control_weight=problem.targets.control_weight * kept.unsqueeze(-1),
    )
    return problem._replace(targets=targets)


def held_out(case: Case, found: Identification, identifier: Identifier, steps: int) -> HeldOut:
    """Errors on the held-out stretches of a case.

    Args:
        case: Model and tracks.
        found: Its identification.
        identifier: What infers the controls.
        steps: How many samples at the end of a stretch are to be foreseen.

    Raises:
        ValueError: A held-out stretch is too short for that.
    """
    tracker, problem, theta = case.tracker, case.data.heldout, found.after.theta
    early = cut_short(problem, steps)
    with torch.no_grad():
        whole = position_error(tracker, found.after.heldout.simulated.states, problem.targets)
        tracked = track(tracker, theta, early, problem.guess, identifier.tracking)
        states = tracked.simulated.states
        ahead = position_error(tracker, states, problem.targets)
    ahead = ahead * (early.targets.weight == 0)
    samples = problem.targets.weight.sum(-1)
    return HeldOut(
        tuple(stretch.name for stretch in case.division.heldout),
        (whole.square().sum(-1) / samples).sqrt(),
        samples,
        (ahead.square().sum(-1) / steps).sqrt(),
    )


def folds(division: Division, count: int, seed: int) -> list[Division]:
    """Divide all stretches so that each is held out once, recordings kept together.

    Args:
        division: The stretches.
        count: Number of folds; no more than there are recordings.
        seed: Of the dealing.

    Raises:
        ValueError: There are fewer than two folds or recordings.
    """
    require_at_least("folds", count, 2)
    stretches = [*division.fitted, *division.heldout]
    recordings = sorted({each.recording for each in stretches})
    require_at_least("recordings", len(recordings), 2, remedy="One is held out at a time.")
    order = torch.randperm(len(recordings), generator=Generator().manual_seed(seed)).tolist()
    fold = {recordings[index]: place % count for place, index in enumerate(order)}
    return [
        Division(
            [each for each in stretches if fold[each.recording] != part],
            [each for each in stretches if fold[each.recording] == part],
        )
        for part in range(min(count, len(recordings)))
    ]


class Studied(NamedTuple):
    """A model, what was identified, and its errors on what was held out."""

    case: Case
    found: Identification
    heldout: HeldOut


@dataclass(frozen=True)
class Study:
    """Identifies and validates several models on the same stretches.

    Args:
        spec: The vehicle.
        division: Stretches to fit and to hold out.
        settings: Noise and regularisation, the same for every model.
        identifier: What identifies.
        foreseen_steps: How many samples at the end of a stretch are to be foreseen.
        folds: Divisions to validate on in turn; on `division` alone if there are none.
    """

    spec: VehicleSpec
    division: Division
    settings: TrackingSettings
    identifier: Identifier
    foreseen_steps: int = 10
    folds: Sequence[Division] = ()

    def __call__(
        self, model: Callable[[], DynamicsModel], parameters: Sequence[str] | None = None
    ) -> Studied:
        """Identify a model on the division, and judge it by what is held out.

        Args:
            model: Builds the model anew.
            parameters: Names of the parameters that may move; all learnable ones by default.

        Raises:
            ValueError: A held-out stretch is too short, or the case cannot be set up.
        """
        case, found = self._identified(model, parameters, self.division, self.identifier)
        # other optima are looked for once: they widen what is claimed, and hardly move errors
        once = replace(self.identifier, starts=0)
        rows = [self._identified(model, parameters, fold, once) for fold in self.folds]
        judged = [
            held_out(*row, self.identifier, self.foreseen_steps) for row in rows or [(case, found)]
        ]
        return Studied(case, found, joined(judged))

    def _identified(
        self,
        model: Callable[[], DynamicsModel],
        parameters: Sequence[str] | None,
        division: Division,
        identifier: Identifier,
    ) -> tuple[Case, Identification]:
        case = Case.of(model(), self.spec, division, self.settings, parameters)
        return case, identifier(case.tracker, case.data)


def joined(parts: Sequence[HeldOut]) -> HeldOut:
    """One record of several, in the order of the stretches' names."""
    names = [name for part in parts for name in part.names]
    order = sorted(range(len(names)), key=names.__getitem__)
    columns = [torch.cat(column)[order] for column in zip(*(p[1:] for p in parts), strict=True)]
    return HeldOut(tuple(names[index] for index in order), *columns)
