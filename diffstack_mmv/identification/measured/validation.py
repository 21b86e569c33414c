"""Roll-outs of windows that took no part in the fit: from a history, with the measured controls."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor

from diffstack_mmv.identification.measured.estimation import (
    WindowEstimate,
    estimate_windows,
)
from diffstack_mmv.identification.measured.fitted import MeasuredFit
from diffstack_mmv.identification.measured.given import InstrumentsGiven
from diffstack_mmv.identification.measured.rides import RideWindows
from diffstack_mmv.identification.measured.simulator import (
    COASTING,
    POSE,
    RECORDING,
    RideSimulator,
)

ITERATIONS = 8
"""Steps of the estimation from a history."""


class RolloutErrors(NamedTuple):
    """Distances to the recorded positions after the history of each window."""

    ade: Float[Tensor, " w"]  # m
    fde: Float[Tensor, " w"]  # m
    coasting: Bool[Tensor, " w"]  # whether the vehicle was taken to outrun its wheel

    @classmethod
    def unknown(cls, windows: RideWindows) -> "RolloutErrors":
        """No errors yet."""
        nothing = torch.full((len(windows.recording),), torch.nan, dtype=torch.float64)
        return cls(nothing, nothing, torch.zeros_like(nothing, dtype=torch.bool))

    def filled(self, chosen: Bool[Tensor, " w"], errors: "RolloutErrors") -> "RolloutErrors":
        """With the errors of some windows."""
        pairs = zip(self, errors, strict=True)
        return RolloutErrors(*(old.masked_scatter(chosen, new) for old, new in pairs))

    def mean(self, chosen: Shaped[Tensor, " w"]) -> dict[str, float]:
        """Means over some windows."""
        return {"ade": float(self.ade[chosen].mean()), "fde": float(self.fde[chosen].mean())}


def session_of(name: str) -> str:
    """Session of a recording: its name without the last number."""
    return name.rpartition("_")[0]


def folds_by(names: Sequence[str], sessions: bool) -> list[Tensor]:
    """Masks (r,) of the recordings that are held out together."""
    labels = [session_of(name) if sessions else name for name in names]
    return [torch.tensor([each == label for each in labels]) for label in sorted(set(labels))]


def errors_of(
    predicted: Float[Tensor, "w T1 2"], windows: RideWindows, history: int
) -> RolloutErrors:
    """Errors after the history."""
    apart = (predicted - windows.position)[:, history + 1 :].norm(dim=-1)
    return RolloutErrors(apart.mean(-1), apart[:, -1], torch.zeros(len(apart), dtype=torch.bool))


def rolled_out(
    simulator: RideSimulator, windows: RideWindows, shared: Tensor, found: WindowEstimate
) -> Float[Tensor, "w T1 2"]:
    """Positions of the antenna over whole windows, the errors of the controls zero at the end."""
    local, count = found.local, simulator.knots(windows.steps)
    known = POSE + RECORDING + COASTING
    steer, pace = local[:, known:].unflatten(1, (2, -1)).unbind(1)
    rest = steer.new_zeros(len(steer), count - steer.shape[-1])
    whole = [local[:, :known], steer, rest, pace, rest]
    return simulator.simulate(windows, shared, torch.cat(whole, -1)).position


def held_out_errors(
    simulator: RideSimulator,
    fit: MeasuredFit,
    windows: RideWindows,
    history: int,
    folds: Sequence[Tensor],
    with_gyro: bool = False,
    coasting: Bool[Tensor, " w"] | None = None,
) -> RolloutErrors:
    """Errors of every window under vehicle and priors that the other folds tell.

    Args:
        simulator: Of the fitted model.
        fit: A fit of all recordings, from which each fold is taken out by a Newton step.
        windows: History and future; the unknowns of its recording are estimated from the history.
        history: Steps of the history.
        folds: Masks of recordings, together all of them.
        with_gyro: Whether the yaw rates of the history are used.
        coasting: Which windows coast; what the history says by default.
    """
    fold = torch.stack(list(folds)).long().argmax(0)[windows.recording]
    shared = torch.stack([fit.shared_without(one) for one in folds])[fold]
    given = InstrumentsGiven.by_fold([fit.instruments.priors(one) for one in folds], fold)
    return future_errors(simulator, windows, shared, given, history, with_gyro, coasting)


def future_errors(
    simulator: RideSimulator,
    windows: RideWindows,
    shared: Float[Tensor, " s"] | Float[Tensor, "w s"],
    given: InstrumentsGiven,
    history: int,
    with_gyro: bool,
    coasting: Bool[Tensor, " w"] | None = None,
) -> RolloutErrors:
    """Errors of roll-outs, all but the vehicle and the priors taken from the history."""
    past = windows.head(history)
    found = estimate_windows(simulator, past, shared, given, with_gyro, ITERATIONS, coasting)
    errors = errors_of(rolled_out(simulator, windows, shared, found), windows, history)
    return errors._replace(coasting=found.coasting)


class PairedTest(NamedTuple):
    """Difference of two models' errors by recording: mean, standard error, t, recordings."""

    mean: float
    standard_error: float
    t: float
    recordings: int
    smaller: int  # recordings in which the first is smaller


def paired_by_recording(
    first: Float[Tensor, " w"], second: Float[Tensor, " w"], recording: Tensor
) -> PairedTest:
    """Compare the mean errors of two models over recordings, whose windows are not independent."""
    each = torch.stack(
        [(first - second)[recording == number].mean() for number in recording.unique()]
    )
    mean, error = float(each.mean()), float(each.std() / len(each) ** 0.5)
    return PairedTest(mean, error, mean / max(error, 1e-12), len(each), int((each < 0).sum()))
