"""Identify the physical parameters of a vehicle from tracks without recorded controls."""

import logging
from datetime import date
from pathlib import Path
from typing import Any

from hydra.utils import instantiate
from omegaconf import DictConfig

from diffstack_mmv.cli import command
from diffstack_mmv.data import read_leans, read_tracks, recorded_noise
from diffstack_mmv.identification import (
    Case,
    Explained,
    Identification,
    Identifier,
    TrackingSettings,
    cut,
    divide,
    lean_agreement,
    losses,
    profiles,
    summarise,
)
from diffstack_mmv.plotting import FittedTrack, save_identification
from diffstack_mmv.reporting import write_identification
from diffstack_mmv.vehicles import config_folder, save_vehicle

logger = logging.getLogger(__name__)


@command(config_folder(), "identify")
def main(config: DictConfig) -> None:
    """Choose stretches, fit, and write the calibrated vehicle, its table and its figures."""
    spec, source, out = instantiate(config.spec), instantiate(config.source), Path(config.out)
    tracks = read_tracks(source, config.splits, spec.mode)
    leans = read_leans(source, config.splits, spec.mode)
    stretches = cut(tracks, instantiate(config.stretch), leans)
    numbers = (config.tracks, config.heldout, config.seed)
    division = divide(stretches, instantiate(config.choice), *numbers)
    measured = recorded_noise(source, spec.mode, config.dt_s)
    noise = measured._asdict() if measured else {}
    noise |= {name: value for name, value in config.noise.items() if value is not None}
    settings = TrackingSettings(**noise, **config.tracking)
    identifier = Identifier(instantiate(config.mode), thresholds=instantiate(config.thresholds))

    def identified(dynamics: DictConfig, parameters: Any) -> tuple[Case, Identification]:
        case = Case.of(instantiate(dynamics), spec, division, settings, parameters)
        return case, identifier(case.tracker, case.data)

    case, found = identified(config.dynamics, config.parameters)
    header = {
        "data": config.data.name,
        "vehicle": spec.name,
        "dynamics": config.names.dynamics,
        "mode": config.names.mode,
        "seed": config.seed,
        "date": date.today().isoformat(),
    }
    models = {config.names.dynamics: losses(case.tracker, case.data, found)}
    for name, each in config.others.items():
        if each and name not in models:
            other, result = identified(each, None)
            models[name] = losses(other.tracker, other.data, result)
    profiled = profiles(case.tracker, case.data, found, identifier.method, config.profile)
    summary = summarise(case.tracker, case.data, found, identifier.thresholds)
    rows = case.explained(found)
    summary |= {
        "models": models,
        "profiles": {name: each._asdict() for name, each in profiled.items()},
        "lean": lean_agreement(rows),
        "smoother": source.smoother,
    }
    write_identification(out, header | summary)
    kept = ("tracks", "heldout_tracks", "smoother", "fitted", *models[header["dynamics"]])
    provenance = header | {key: summary[key] for key in kept}
    told = f"identified from {summary['tracks']} tracks of {config.data.name}"
    save_vehicle(case.calibrated(spec, found, told), out / "vehicle.yaml", provenance)
    controls = case.tracker.vehicle.model.Control._fields
    save_identification(out, summary, [drawn(row) for row in rows], controls, config.dt_s)
    logger.info("Report: %s", out / "identification.md")


def drawn(row: Explained) -> FittedTrack:
    """A track and its explanation as arrays."""
    stretch = row.stretch
    leans = (each if each is None else each.numpy() for each in (row.lean, stretch.lean))
    parts = (stretch.position, row.position, row.controls)
    return FittedTrack(stretch.name, *(part.numpy() for part in parts), *leans)


if __name__ == "__main__":
    main()
