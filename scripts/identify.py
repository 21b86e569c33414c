"""Identify the physical parameters of a vehicle from tracks without recorded controls."""

import logging
from datetime import date
from functools import partial
from pathlib import Path

from hydra.utils import instantiate
from omegaconf import DictConfig

from diffstack_mmv.cli import command
from diffstack_mmv.data import WindowSource, read_controls, read_leans, read_tracks, recorded_noise
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification import Recordings, identification_result, vehicle_provenance
from diffstack_mmv.plotting import FittedTrack, save_identification
from diffstack_mmv.reporting import write_identification
from diffstack_mmv.vehicles import config_folder, save_vehicle

logger = logging.getLogger(__name__)


@command(config_folder(), "identify")
def main(config: DictConfig) -> None:
    """Identify the model, and write the calibrated vehicle, its table and its figures."""
    study, source, out = instantiate(config.study), instantiate(config.source), Path(config.out)
    name, data, spec = config.names.dynamics, config.data.name, study.spec
    others = {other: model for other, model in config.others.items() if model and other != name}
    models = {each: partial(instantiate, model) for each, model in others.items()}
    models = {name: partial(instantiate, config.dynamics)} | models
    recordings = read(config, source, spec.mode, models[name]())
    result = study(recordings, models)
    header = {"data": data, "vehicle": spec.name, "dynamics": name, "mode": config.names.mode}
    header |= {"seed": config.seed, "date": date.today().isoformat()}
    content = identification_result(study, recordings, result)
    write_identification(out, header | content)
    tracks = [FittedTrack(**motion.arrays()) for motion in result.motions()]
    save_identification(out, content, tracks, result.controls, config.dt_s)
    told = f"identified from {content['tracks']} tracks of {data}"
    provenance = vehicle_provenance(header, content, name)
    save_vehicle(result.calibrated(spec, told), out / "vehicle.yaml", provenance)
    logger.info("Report: %s", out / "identification.md")


def read(config: DictConfig, source: WindowSource, mode: str, model: DynamicsModel) -> Recordings:
    """Tracks of a mode with what was measured beside them."""
    place, controls = (source, config.splits, mode), model.Control._fields
    return Recordings(
        read_tracks(*place),
        read_leans(*place),
        read_controls(*place, controls) if config.controls else None,
        recorded_noise(source, mode, config.dt_s),
        source.smoother,
    )


if __name__ == "__main__":
    main()
