"""The numbers of an identification under the keys of `identification.json`."""

from typing import Any

from diffstack_mmv.identification.inference.combinations import combinations
from diffstack_mmv.identification.inference.excitation import friction_of, measure_excitation
from diffstack_mmv.identification.inference.identifier import Identification
from diffstack_mmv.identification.inference.influence import regularisation_influence
from diffstack_mmv.identification.inference.optima import posterior_shares
from diffstack_mmv.identification.inference.sensitivity import (
    IdentifiabilityThresholds,
    describe_direction,
)
from diffstack_mmv.identification.report.remarks import all_remarks
from diffstack_mmv.identification.shooting.fit import EstimationData
from diffstack_mmv.identification.shooting.linearisation import TrackSimulator
from diffstack_mmv.identification.shooting.problem import TrackingProblem
from diffstack_mmv.identification.shooting.tracking import TrackingSolution, tracking_rmse


def overall_rmse(
    simulator: TrackSimulator, problem: TrackingProblem, solution: TrackingSolution
) -> float:
    """Root mean square tracking error in m over all recorded samples."""
    samples = problem.measurements.weight.sum(-1)
    squares = tracking_rmse(simulator, solution.simulated.states, problem.measurements).square()
    return float(((squares * samples).sum() / samples.sum()).sqrt())


def tracking_losses(
    simulator: TrackSimulator, data: EstimationData, found: Identification
) -> dict[str, float]:
    """Tracking errors in m under the keys of `identification.json`."""
    before, after = found.before, found.after
    return {
        "loss_before": overall_rmse(simulator, data.fitted, before.fitted),
        "loss_after": overall_rmse(simulator, data.fitted, after.fitted),
        "heldout_before": overall_rmse(simulator, data.heldout, before.heldout),
        "heldout_after": overall_rmse(simulator, data.heldout, after.heldout),
    }


def summarise(
    simulator: TrackSimulator,
    data: EstimationData,
    found: Identification,
    thresholds: IdentifiabilityThresholds,
) -> dict[str, Any]:
    """Content of `identification.json` as far as it follows from one model."""
    before, after = found.before, found.after
    friction = friction_of(simulator, after.theta)
    demands = measure_excitation(simulator, data.fitted, after.fitted.simulated, friction)
    names = simulator.parameters.names
    influence = regularisation_influence(simulator, data.fitted, after, found.active)
    return {
        "tracks": len(data.fitted.start),
        "heldout_tracks": len(data.heldout.start),
        "loss": "root mean square distance between track and fit in m",
        **tracking_losses(simulator, data, found),
        "cost_before": float(before.fitted.simulated.cost.sum()),
        "cost_after": float(after.fitted.simulated.cost.sum()),
        "heldout_cost_before": float(before.heldout.simulated.cost.sum()),
        "heldout_cost_after": float(after.heldout.simulated.cost.sum()),
        "converged": float(after.fitted.converged.double().mean()),
        "noise_factor": found.noise_factor,
        "fitted": [
            name for name, active in zip(names, found.active.tolist(), strict=True) if active
        ],
        "parameters": _parameters(simulator, found),
        "combinations": _combinations(simulator, found, thresholds),
        "eigenvalues": [direction.eigenvalue for direction in found.sensitivity.directions],
        "directions": [
            {"information": each.eigenvalue, "direction": describe_direction(each, names)}
            for each in found.sensitivity.directions
        ],
        "optima": _optima(simulator, found),
        "remarks": all_remarks(simulator, found, demands, influence),
        "excitation": demands._asdict(),
        "regularisation_influence": {
            name: dict(zip(names, change.tolist(), strict=True))
            for name, change in influence.items()
        },
        "history": [each._asdict() for each in after.history],
    }


def _parameters(simulator: TrackSimulator, found: Identification) -> dict[str, dict[str, Any]]:
    parameters, sensitivity = simulator.parameters, found.sensitivity
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
            "verdict": str(found.identifiability[index]),
        }
        for index, name in enumerate(parameters.names)
    }


def _combinations(
    simulator: TrackSimulator, found: Identification, thresholds: IdentifiabilityThresholds
) -> dict[str, dict[str, Any]]:
    model, parameters = simulator.vehicle.model, simulator.parameters
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
        for row in combinations(model, parameters, found.optima, thresholds)
    }


def _optima(simulator: TrackSimulator, found: Identification) -> list[dict[str, Any]]:
    parameters = simulator.parameters
    shares = posterior_shares(found.optima).tolist()
    return [
        {
            "share": share,
            "cost": each.cost,
            "values": dict(
                zip(parameters.names, parameters.values(each.fit.theta).tolist(), strict=True)
            ),
        }
        for share, each in zip(shares, found.optima, strict=True)
    ]
