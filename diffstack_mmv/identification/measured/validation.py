"""Roll-outs of windows that took no part in the fit: from a history, with the measured controls."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.geometry import direction
from diffstack_mmv.identification.measured.estimation import WindowEstimate, estimate_windows
from diffstack_mmv.identification.measured.fit import MeasuredFit
from diffstack_mmv.identification.measured.instruments import InstrumentPriors
from diffstack_mmv.identification.measured.rides import RideWindows
from diffstack_mmv.identification.measured.simulator import POSE, RECORDING, RideSimulator


class RolloutErrors(NamedTuple):
    """Distances to the recorded positions after the history of each window."""

    ade: Float[Tensor, " w"]  # m
    fde: Float[Tensor, " w"]  # m

    def mean(self, chosen: Tensor) -> dict[str, float]:
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
    return RolloutErrors(apart.mean(-1), apart[:, -1])


def rolled_out(
    simulator: RideSimulator, windows: RideWindows, shared: Tensor, found: WindowEstimate
) -> Float[Tensor, "w T1 2"]:
    """Positions of the antenna over whole windows, the errors of the controls zero at the end."""
    local, count = found.local, simulator.knots(windows.steps)
    steer, pace = local[:, POSE + RECORDING :].unflatten(1, (2, -1)).unbind(1)
    rest = steer.new_zeros(len(steer), count - steer.shape[-1])
    whole = [local[:, : POSE + RECORDING], steer, rest, pace, rest]
    return simulator.simulate(windows, shared, torch.cat(whole, -1)).position


def held_out_errors(
    simulator: RideSimulator,
    fit: MeasuredFit,
    windows: RideWindows,
    priors: InstrumentPriors,
    history: int,
    folds: Sequence[Tensor],
    with_gyro: bool = False,
) -> RolloutErrors:
    """Errors of every window under the vehicle fitted to the recordings of other folds.

    Args:
        simulator: Of the fitted model.
        fit: A fit of all recordings, from which each fold is taken out.
        windows: History and future; the unknowns of its recording are estimated from the history.
        priors: Of the instruments.
        history: Steps of the history.
        folds: Masks of recordings, together all of them.
        with_gyro: Whether the yaw rates of the history are used.
    """
    mean, std = priors.recording()
    ade, fde = torch.zeros(2, len(windows.recording), dtype=torch.float64).unbind()
    for fold in folds:
        chosen = fold[windows.recording]
        if not bool(chosen.any()):
            continue
        part = windows.select(chosen)
        shared = fit.shared_without(fold)
        count = len(part.recording)
        prior = (mean.expand(count, -1), std.pow(-2).diag().expand(count, -1, -1))
        found = estimate_windows(simulator, part.head(history), shared, *prior, with_gyro)
        errors = errors_of(rolled_out(simulator, part, shared, found), part, history)
        ade[chosen], fde[chosen] = errors.ade, errors.fde
    return RolloutErrors(ade, fde)


def baseline_errors(
    windows: RideWindows, history: int, dt_s: float, wheelbase_m: float
) -> Mapping[str, RolloutErrors]:
    """Constant velocity, the nominal kinematic bicycle, and dead reckoning by the gyro.

    They start at the last position, in the direction of the last half second (in a turn corrected
    by the yaw rate), and take the measured speed as it is.
    """
    last = windows.position[:, history]
    way = last - windows.position[:, history - 5]
    constant = last.unsqueeze(1) + _ahead(windows, history).unsqueeze(-1) * way.unsqueeze(1) / 5
    steering = windows.speed[:, :-1] * windows.steer.tan() / wheelbase_m
    found = {"constant velocity": constant}
    turns = {"nominal kinematic bicycle": steering, "gyro dead reckoning": windows.yaw_rate}
    for name, yaw_rate in turns.items():
        found[name] = _reckoned(windows, yaw_rate, history, dt_s)
    return {name: errors_of(path, windows, history) for name, path in found.items()}


def _ahead(windows: RideWindows, history: int) -> Float[Tensor, "1 T1"]:
    return (torch.arange(windows.steps + 1, dtype=torch.float64) - history).unsqueeze(0)


def _reckoned(
    windows: RideWindows, yaw_rate: Float[Tensor, "w T"], history: int, dt_s: float
) -> Float[Tensor, "w T1 2"]:
    """Path from yaw rates and measured speed; the direction at the start fits the last second."""
    turned = torch.cat([yaw_rate[:, :1] * 0, yaw_rate.cumsum(-1)], -1) * dt_s
    turned = turned - turned[:, history : history + 1]
    pace = 0.5 * (windows.speed[:, 1:] + windows.speed[:, :-1]).unsqueeze(-1) * dt_s
    steps = pace * direction(0.5 * (turned[:, 1:] + turned[:, :-1]))
    path = torch.cat([steps[:, :1] * 0, steps.cumsum(1)], 1)
    path = path - path[:, history : history + 1]
    before = history - 10
    own, seen = -path[:, before], windows.position[:, history] - windows.position[:, before]
    turn = torch.atan2(seen[:, 1], seen[:, 0]) - torch.atan2(own[:, 1], own[:, 0])
    cosine, sine = turn.cos()[:, None], turn.sin()[:, None]
    east = cosine * path[..., 0] - sine * path[..., 1]
    north = sine * path[..., 0] + cosine * path[..., 1]
    return torch.stack([east, north], -1) + windows.position[:, history : history + 1]


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
