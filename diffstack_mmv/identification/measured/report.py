"""Numbers of a study of measured rides under the keys of `identification.json`."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import torch

from diffstack_mmv.identification.inference import IdentifiabilityThresholds
from diffstack_mmv.identification.measured.fitted import MeasuredFit
from diffstack_mmv.identification.measured.instruments import INSTALLED_NAMES, OF_RECORDING
from diffstack_mmv.identification.measured.rollout_report import rollout_table, rollout_tests
from diffstack_mmv.identification.measured.simulator import INSTALLED, RideSimulator
from diffstack_mmv.identification.measured.study import MeasuredStudy, MeasuredStudyResult, ModelFit

WITHIN = 1.96
"""Deviations of an interval that holds 95 %."""


def measured_result(
    study: MeasuredStudy, result: MeasuredStudyResult, thresholds: IdentifiabilityThresholds
) -> dict[str, Any]:
    """Content of `identification.json` after its header.

    Losses are mean distances in m of roll-outs over the horizon, before (nominal bicycle) and
    after the fit, those held out by recording; `loss_after` is that of the fit itself.
    """
    name, first = next(iter(result.models.items()))
    every = torch.ones(len(result.rollouts.recording), dtype=torch.bool)
    nominal = result.baselines["nominal wheelbase, raw speed"].mean(every)["ade"]
    return {
        "tracks": len(result.windows.recording),
        "heldout_tracks": len(result.rollouts.recording),
        "loss": "root mean square distance in m of fitted windows; held out: ADE of roll-outs",
        "loss_before": nominal,
        "loss_after": first.fit.rms_m,
        "heldout_before": nominal,
        "heldout_after": first.by_recording.plain.mean(every)["ade"],
        "parameters": fitted_parameters(first.simulator, first.fit, thresholds),
        "models": {each: _model(found, thresholds) for each, found in result.models.items()},
        "recordings": _recordings(result.windows.names, first.fit),
        "rollouts": rollout_table(result),
        "tests": rollout_tests(name, result),
        "processor_seconds": dict(result.seconds),
        "assumed": {
            "noise": asdict(result.noise),
            "priors_to_begin_with": asdict(study.fitter.priors),
            "priors": asdict(result.priors),
            "window_s": study.fitted.steps * study.fitted.dt_s,
            "history_s": study.history_s,
            "horizon_s": study.horizon_s,
        },
    }


def fitted_parameters(
    simulator: RideSimulator, fit: MeasuredFit, thresholds: IdentifiabilityThresholds
) -> dict[str, dict[str, Any]]:
    """Vehicle parameters with 95 % intervals and verdicts."""
    vector = simulator.parameters
    values, prior = vector.values(fit.point.shared[: len(vector)]), vector.prior
    found = {}
    for index, name in enumerate(vector.names):
        value, std = float(values[index]), float(fit.shared_std[index])
        ratio = std / float(prior.std[index])
        found[name] = {
            "initial": float(prior.mean[index]),
            "estimate": value,
            "low": float(prior.low[index]),
            "high": float(prior.high[index]),
            "unit": vector.units[index],
            "std": std,
            "std_laplace": float(fit.laplace_std[index]),
            "std_jackknife": float(fit.jackknife_std[index]),
            "prior_std": float(prior.std[index]),
            "interval_95": [value - WITHIN * std, value + WITHIN * std],
            "identifiability": max(0.0, 1 - ratio),
            "verdict": str(thresholds.classify(ratio, std / abs(value), fit.noise_factor)),
        }
    return found


def _model(found: ModelFit, thresholds: IdentifiabilityThresholds) -> dict[str, Any]:
    fit, per_curvature = found.fit, found.simulator.steer_per_curvature
    value, std = float(per_curvature(fit.point.shared)), fit.std_of(per_curvature)
    installed = zip(INSTALLED_NAMES, fit.point.shared[-INSTALLED:], strict=True)
    return {
        "loss_after": fit.rms_m,
        "log_evidence": fit.log_evidence,
        "noise_factor": fit.noise_factor,
        "iterations": fit.iterations,
        "converged": fit.converged,
        "coasting_windows": int(fit.point.coasting.sum()),
        "parameters": fitted_parameters(found.simulator, fit, thresholds),
        "steer_per_curvature_at_3_mps": {
            "estimate": value,
            "std": std,
            "interval_95": [value - WITHIN * std, value + WITHIN * std],
            "unit": "m",
        },
        "installed": {
            name: {
                "estimate": float(each),
                "std": float(fit.shared_std[index - INSTALLED]),
                "std_laplace": float(fit.laplace_std[index - INSTALLED]),
                "std_jackknife": float(fit.jackknife_std[index - INSTALLED]),
            }
            for index, (name, each) in enumerate(installed)
        },
    }


def _recordings(names: tuple[str, ...], fit: MeasuredFit) -> dict[str, dict[str, float]]:
    """Offsets, scales and delay of each recording, each with its deviation."""
    found = {}
    for index, name in enumerate(names):
        row: dict[str, float] = {}
        for column, unknown in enumerate(OF_RECORDING):
            row[unknown] = float(fit.point.recording[index, column])
            row[f"{unknown}_std"] = float(fit.recording_std[index, column])
        found[name] = row
    return found


def measured_tables(content: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Tables for `identification.md`: models, parameters, instruments, roll-outs, tests."""
    parameters = [
        {"model": model, "parameter": name}
        | {key: entry[key] for key in ("initial", "prior_std", "estimate", "std")}
        | {"95 % low": entry["interval_95"][0], "95 % high": entry["interval_95"][1]}
        | {key: entry[key] for key in ("unit", "verdict")}
        for model, told in content["models"].items()
        for name, entry in told["parameters"].items()
    ]
    rollouts = [
        {"group": group, "line": line, "ADE": errors["ade"], "FDE": errors["fde"]}
        for group, lines in content["rollouts"].items()
        for line, errors in lines.items()
        if "ade" in errors
    ]
    tests = [{"difference of ADE": name, **test} for name, test in content["tests"].items()]
    models = [
        {
            "model": name,
            "log evidence": told["log_evidence"],
            "rms of the fit": told["loss_after"],
            "iterations": told["iterations"],
            "converged": told["converged"],
            "steering per curvature": told["steer_per_curvature_at_3_mps"]["estimate"],
            "its std": told["steer_per_curvature_at_3_mps"]["std"],
            "processor seconds": content["processor_seconds"][name],
        }
        for name, told in content["models"].items()
    ]
    installed = [
        {"model": name, "unknown": unknown, **entry}
        for name, told in content["models"].items()
        for unknown, entry in told["installed"].items()
    ]
    recordings = [{"recording": name, **row} for name, row in content["recordings"].items()]
    return {
        "Models": models,
        "Parameters": parameters,
        "Installed": installed,
        "Recordings": recordings,
        "Roll-outs": rollouts,
        "Tests": tests,
    }
