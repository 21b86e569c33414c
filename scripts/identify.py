"""Identify the physical parameters of a vehicle from tracks without recorded controls."""

import logging
from dataclasses import asdict, replace
from datetime import date
from pathlib import Path
from typing import Any

from hydra.utils import instantiate
from omegaconf import DictConfig

from diffstack_mmv.checks import require
from diffstack_mmv.cli import command
from diffstack_mmv.data import WindowSource, read_controls, read_leans, read_tracks, recorded_noise
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification import (
    Division,
    Explained,
    Identifier,
    Studied,
    Study,
    TrackingSettings,
    beyond_limits,
    cut,
    divide,
    folds,
    lean_agreement,
    losses,
    profiles,
    ridden,
    summarise,
)
from diffstack_mmv.plotting import FittedTrack, save_identification
from diffstack_mmv.reporting import write_identification
from diffstack_mmv.vehicles import VehicleSpec, config_folder, save_vehicle

logger = logging.getLogger(__name__)


@command(config_folder(), "identify")
def main(config: DictConfig) -> None:
    """Choose stretches, fit, and write the calibrated vehicle, its table and its figures."""
    spec, source, out = instantiate(config.spec), instantiate(config.source), Path(config.out)
    name, division = config.names.dynamics, choose(config, spec, source)
    settings = assumptions(config, spec, source, division)
    thresholds = instantiate(config.thresholds)
    identifier = Identifier(instantiate(config.mode), thresholds=thresholds, starts=config.starts)
    parts = folds(division, config.folds, config.seed) if config.folds else ()
    steps = round(config.foresee_s / config.dt_s)
    study = Study(spec, division, settings, identifier, steps, parts)
    studied = {name: study(lambda: instantiate(config.dynamics), config.parameters)}
    for other, model in config.others.items():
        if model and other not in studied and drives(instantiate(model), config):
            studied[other] = study(lambda model=model: instantiate(model))
    case, found, _ = studied[name]
    header = {
        "data": config.data.name,
        "vehicle": spec.name,
        "dynamics": name,
        "mode": config.names.mode,
        "seed": config.seed,
        "date": date.today().isoformat(),
    }
    profiled = profiles(case.tracker, case.data, found, identifier.method, config.profile)
    rows = case.explained(found)
    used = [*division.fitted, *division.heldout]
    summary = summarise(case.tracker, case.data, found, thresholds) | {
        **compared(config, studied),
        "assumed": asdict(settings),
        "beyond_limits": beyond_limits(used, spec.limits, config.dt_s),
        "profiles": {key: each._asdict() for key, each in profiled.items()},
        "lean": lean_agreement(rows, config.dt_s),
        "smoother": source.smoother(),
    }
    write_identification(out, header | summary)
    kept = ("tracks", "heldout_tracks", "smoother", "assumed", "fitted", *summary["models"][name])
    provenance = header | {key: summary[key] for key in kept}
    told = f"identified from {summary['tracks']} tracks of {config.data.name}"
    save_vehicle(case.calibrated(spec, found, told), out / "vehicle.yaml", provenance)
    controls = case.tracker.vehicle.model.Control._fields
    save_identification(out, summary, [drawn(row) for row in rows], controls, config.dt_s)
    logger.info("Report: %s", out / "identification.md")


def choose(config: DictConfig, spec: VehicleSpec, source: WindowSource) -> Division:
    """Stretches to fit and to hold out, with what was measured beside them."""
    recorded = None
    if config.controls:
        own = instantiate(config.dynamics).Control._fields
        known = tuple(config.controls)
        require(own == known, "controls", f"name {', '.join(own)} in this order", ", ".join(known))
        recorded = read_controls(source, config.splits, spec.mode, own)
    tracks = read_tracks(source, config.splits, spec.mode)
    leans = read_leans(source, config.splits, spec.mode)
    stretches = cut(tracks, instantiate(config.stretch), leans, recorded)
    numbers = (config.tracks, config.heldout, config.seed)
    return divide(stretches, instantiate(config.choice), *numbers)


def compared(config: DictConfig, studied: dict[str, Studied]) -> dict[str, Any]:
    """Errors of all models, the identified one first."""
    first = next(iter(studied.values())).heldout
    return {
        "models": {
            name: losses(each.case.tracker, each.case.data, each.found)
            for name, each in studied.items()
        },
        "validation": {
            "folds": config.folds,
            "stretches": len(first.names),
            "foresee_s": config.foresee_s,
            "models": {
                name: each.heldout.pooled() | each.heldout.change_from(first)
                for name, each in studied.items()
            },
        },
    }


def assumptions(
    config: DictConfig, spec: VehicleSpec, source: WindowSource, division: Division
) -> TrackingSettings:
    """Noise and regularisation: as configured, where null as the recordings tell."""
    measured = recorded_noise(source, spec.mode, config.dt_s)
    noise = measured._asdict() if measured else {}
    noise |= {name: value for name, value in config.noise.items() if value is not None}
    given = {name: value for name, value in config.tracking.items() if value is not None}
    controls = tuple(config.controls.values()) if config.controls else None
    settings = TrackingSettings(**noise, **given, control_noise=controls)
    if {"jerk_mps3", "curvature_rate"} <= set(given):
        return settings
    return replace(ridden(settings, spec, division.fitted, config.dt_s), **given)


def drives(model: DynamicsModel, config: DictConfig) -> bool:
    """Whether the recorded controls, if there are any, are those of a model."""
    own = model.Control._fields
    if not config.controls or own == tuple(config.controls):
        return True
    logger.warning("%s is not compared: its controls %s were not recorded", type(model), own)
    return False


def drawn(row: Explained) -> FittedTrack:
    """A track and its explanation as arrays."""
    stretch = row.stretch
    leans = (each if each is None else each.numpy() for each in (row.lean, stretch.lean))
    parts = (stretch.position, row.position, row.controls)
    return FittedTrack(stretch.name, *(part.numpy() for part in parts), *leans)


if __name__ == "__main__":
    main()
