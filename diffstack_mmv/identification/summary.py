"""The result of an identification as plain numbers and words, for files and tables."""

from collections.abc import Mapping, Sequence
from typing import Any

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.identification.combinations import Combination, combinations
from diffstack_mmv.identification.excitation import Excitation, excitation
from diffstack_mmv.identification.fit import Data
from diffstack_mmv.identification.identify import Identification
from diffstack_mmv.identification.influence import regularisation_influence
from diffstack_mmv.identification.linearisation import Tracker
from diffstack_mmv.identification.optima import Optimum, shares
from diffstack_mmv.identification.problem import Problem
from diffstack_mmv.identification.sensitivity import Thresholds, Verdict, describe
from diffstack_mmv.identification.tracking import Tracked, tracking_rmse

NEAR_THE_LIMIT = 0.6  # of the adhesion limit: above, friction shapes the path
MISFIT = 1.25  # residuals over assumed noise
SUSPICIOUS = 0.5  # prior deviations
AT_THE_EDGE = 0.01  # of the range
NOTEWORTHY = 0.05  # share of the posterior of an optimum that is told in words
WEAKEST = 3  # directions that are told in words


def overall_rmse(tracker: Tracker, problem: Problem, tracked: Tracked) -> float:
    """Root mean square tracking error in m over all recorded samples."""
    samples = problem.targets.weight.sum(-1)
    squares = tracking_rmse(tracker, tracked.simulated.states, problem.targets).square()
    return float(((squares * samples).sum() / samples.sum()).sqrt())


def losses(tracker: Tracker, data: Data, found: Identification) -> dict[str, float]:
    """Tracking errors in m under the keys of `identification.json`."""
    before, after = found.before, found.after
    return {
        "loss_before": overall_rmse(tracker, data.fitted, before.fitted),
        "loss_after": overall_rmse(tracker, data.fitted, after.fitted),
        "heldout_before": overall_rmse(tracker, data.heldout, before.heldout),
        "heldout_after": overall_rmse(tracker, data.heldout, after.heldout),
    }


def summarise(
    tracker: Tracker, data: Data, found: Identification, thresholds: Thresholds
) -> dict[str, Any]:
    """Content of `identification.json` as far as the numbers decide it."""
    before, after = found.before, found.after
    demands = excitation(tracker, data.fitted, after.fitted.simulated)
    names = tracker.parameters.names
    influence = regularisation_influence(tracker, data.fitted, after, found.active)
    return {
        "tracks": len(data.fitted.start),
        "heldout_tracks": len(data.heldout.start),
        "loss": "root mean square distance between track and fit in m",
        **losses(tracker, data, found),
        "cost_before": float(before.fitted.simulated.cost.sum()),
        "cost_after": float(after.fitted.simulated.cost.sum()),
        "heldout_cost_before": float(before.heldout.simulated.cost.sum()),
        "heldout_cost_after": float(after.heldout.simulated.cost.sum()),
        "converged": float(after.fitted.converged.double().mean()),
        "noise_factor": found.noise_factor,
        "fitted": [
            name for name, active in zip(names, found.active.tolist(), strict=True) if active
        ],
        "parameters": _parameters(tracker, found),
        "combinations": _combinations(tracker, found, thresholds),
        "eigenvalues": [direction.eigenvalue for direction in found.sensitivity.directions],
        "directions": [
            {"information": each.eigenvalue, "direction": describe(each, names)}
            for each in found.sensitivity.directions
        ],
        "optima": [
            {"share": share, "cost": each.cost, "values": dict(zip(names, values, strict=True))}
            for share, each, values in _shared(tracker, found)
        ],
        "remarks": [
            *remarks(tracker, found, demands),
            *ambiguities(tracker, found),
            *suspicions(tracker, found, influence),
        ],
        "excitation": demands._asdict(),
        "regularisation_influence": {
            name: dict(zip(names, change.tolist(), strict=True))
            for name, change in influence.items()
        },
        "history": [each._asdict() for each in after.history],
    }


def _parameters(tracker: Tracker, found: Identification) -> dict[str, dict[str, Any]]:
    parameters, sensitivity = tracker.parameters, found.sensitivity
    values = parameters.values(found.after.theta).tolist()
    prior = parameters.prior
    return {
        name: {
            "initial": float(prior.mean[index]),
            "estimate": values[index],
            "low": float(prior.low[index]),
            "high": float(prior.high[index]),
            "unit": parameters.units[index],
            "std": float(sensitivity.std[index]),
            "prior_std": float(prior.std[index]),
            # share of the prior's standard deviation that the tracks took away
            "identifiability": 1 - float(sensitivity.marginal_ratio[index]),
            "conditional_identifiability": 1 - float(sensitivity.conditional_ratio[index]),
            "verdict": str(found.verdicts[index]),
        }
        for index, name in enumerate(parameters.names)
    }


def _combinations(
    tracker: Tracker, found: Identification, thresholds: Thresholds
) -> dict[str, dict[str, Any]]:
    rows: Sequence[Combination] = combinations(
        tracker.vehicle.model,
        tracker.parameters,
        found.optima,
        thresholds,
    )
    return {
        row.name: {
            "initial": row.initial,
            "estimate": row.estimate,
            "unit": row.unit,
            "std": row.std,
            "prior_std": row.prior_std,
            "identifiability": max(0.0, 1 - row.std / row.prior_std) if row.prior_std > 0 else 0.0,
            "verdict": str(row.verdict),
        }
        for row in rows
    }


def remarks(tracker: Tracker, found: Identification, demands: Excitation) -> list[str]:
    """What the tracks do not say, and why, in words."""
    names = tracker.parameters.names
    if not names:
        return ["The model has no learnable parameter: the tracks were only followed."]
    told = []
    settings = tracker.vehicle.settings
    silent = {
        name.split(".")[0]
        for name, verdict in zip(names, found.verdicts, strict=True)
        if verdict is Verdict.NOT_IDENTIFIABLE
    }
    reasons: Mapping[str, str] = {
        "friction": "the tyres are never asked for more than "
        f"{100 * demands.adhesion:.0f} % of the adhesion limit"
        if demands.adhesion < NEAR_THE_LIMIT
        else "a rider whose controls are unknown may simply have asked for less",
        "wheelbase": "steering was not recorded and is free, so every wheelbase gives the same path"
        if settings.steer_rate_radps is None and settings.control_noise is None
        else "the steering prior is too wide for it",
        "roll_inertia": "lean moves the path by less than the noise",
        "roll_damping": "lean moves the path by less than the noise",
        "yaw_inertia": "the yaw follows the steering faster than the tracks are sampled",
    }
    for name in sorted(silent):
        reason = reasons.get(name, "its effect on the paths is lost in noise and free steering")
        told.append(f"{name} is not observable in these tracks: {reason}; it stays at its prior.")
    for direction in found.sensitivity.directions[-WEAKEST:]:
        told.append(
            f"Weak direction ({direction.eigenvalue:.2g} of the prior's information): "
            f"{describe(direction, names)}."
        )
    best = found.sensitivity.directions[0]
    told.append(
        f"Best informed direction ({best.eigenvalue:.3g} times the prior's information): "
        f"{describe(best, names)}."
    )
    return told


def _shared(tracker: Tracker, found: Identification) -> list[tuple[float, Optimum, list[float]]]:
    """Share of the posterior, optimum and values, the estimate first."""
    rows = shares(found.optima).tolist()
    return [
        (share, each, tracker.parameters.values(each.fit.theta).tolist())
        for share, each in zip(rows, found.optima, strict=True)
    ]


def ambiguities(tracker: Tracker, found: Identification) -> list[str]:
    """Other values that explain the tracks about as well, in words."""
    first, *others = _shared(tracker, found)
    std = first[1].sensitivity.std.tolist()
    told = []
    for share, _, values in others:
        differing = [
            f"{name} {value:.3g}"
            for name, value, best, each in zip(
                tracker.parameters.names, values, first[2], std, strict=True
            )
            if abs(value - best) > each
        ]
        if share >= NOTEWORTHY:
            told.append(
                f"Another optimum holds {100 * share:.0f} % of the posterior: "
                f"{', '.join(differing)}. The deviations include it."
            )
    return told


def suspicions(
    tracker: Tracker, found: Identification, influence: Mapping[str, Float[Tensor, " p"]]
) -> list[str]:
    """Estimates that owe more to assumptions than to tracks, and estimates at their bounds."""
    parameters, told = tracker.parameters, []
    for setting, changes in influence.items():
        for name, change in zip(parameters.names, changes.tolist(), strict=True):
            if abs(change) > SUSPICIOUS:
                told.append(
                    f"The estimate of {name} hangs on the assumed `{setting}`: twice of it would "
                    f"move it by {change:+.1f} prior deviations. Do not trust it."
                )
    if len(parameters) and found.noise_factor > MISFIT:
        told.append(
            f"The residuals are {found.noise_factor:.2f} times the assumed noise: the model does "
            "not explain the tracks, or the fit ended in a poor optimum. Do not trust it."
        )
    values, prior = parameters.values(found.after.theta), parameters.prior
    margin = AT_THE_EDGE * (prior.high - prior.low)
    for name, value, low, high in zip(
        parameters.names, values, prior.low + margin, prior.high - margin, strict=True
    ):
        if not low <= value <= high:
            told.append(f"The estimate of {name} lies at the edge of its range: widen the range.")
    return told
