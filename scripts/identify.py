"""Identify the physical parameters of a vehicle from tracks, with or without measured controls."""

import logging
from collections.abc import Collection, Sequence
from dataclasses import replace
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

from diffstack_mmv.commands.cli import DictConfig, OmegaConf, command, instantiate, refuse_beside
from diffstack_mmv.commands.data_checks import require_step_of, require_tracks
from diffstack_mmv.commands.records import log_record
from diffstack_mmv.commands.run_checks import require_same_run
from dmmv_conventions.checks import message, require
from dmmv_conventions.configs import config_folder
from dmmv_conventions.versions import code_version

logger = logging.getLogger(__name__)


MEASURED = "measured"
"""Value of `controls` for steering and speed whose instruments are unknown too."""

OF_TRACKS = frozenset(
    ["tracks", "heldout", "folds", "foresee_s", "stretch", "choice", "parameters", "profile"]
    + ["noise", "tracking", "starts", "mode", "study"]
)
"""Settings that only a study of tracks reads, not one of measured controls."""


def check(config: DictConfig) -> None:
    """Refuse a study without recordings of the vehicle, or of what cannot be identified."""
    require_tracks(config.data.module.source, config.splits, config.vehicle.mode)
    require_step_of(config.data.module.source, config.dt_s)
    # for their mistakes alone, before the recordings are read
    measured = config.controls == MEASURED
    understood = config.controls is None or measured or isinstance(config.controls, DictConfig)
    needs = f"be {MEASURED}, or noise by name as in {{acceleration: 0.05, steer: 0.002}}"
    require(understood, "controls", needs, config.controls)
    for name in ("parameters", "profile"):
        given = config.study.get(name)
        require(not isinstance(given, str), name, "be a list of names, as in [wheelbase]", given)
    if measured:
        refuse_beside(f"controls={MEASURED}", OF_TRACKS)
        instantiate(config.thresholds)
    study = instantiate(config.measured if measured else config.study)
    study.require_models(builders(config))


def builders(config: DictConfig) -> dict[str, partial[Any]]:
    """What builds each model by its name, the one to identify first."""
    name = config.names.dynamics
    others = {each: node for each, node in config.others.items() if node and each != name}
    return {
        each: partial(instantiate, node)
        for each, node in ({name: config.dynamics} | others).items()
    }


def admit(config: DictConfig) -> None:
    """Refuse a folder with what was identified with other settings: figures of both would stay."""
    content: Any = OmegaConf.to_container(config)
    require_same_run(Path(config.out), "identify", content)


@command(config_folder(), "identify", check, admit)
def main(config: DictConfig) -> None:
    """Identify the model, and write the calibrated vehicle, its table and its figures.

    Raises:
        ValueError: The tracks do not inform the problem.
    """
    identify = identify_measured if config.controls == MEASURED else identify_tracks
    identify(config)
    out = Path(config.out)
    log_record(config)
    logger.info("Report: %s; as a page: dmmv-report %s", out / "identification.md", out)


def identify_tracks(config: DictConfig) -> None:
    """Fit a vehicle to tracks, and write it, numbers, tables and figures."""
    study, source, out = instantiate(config.study), instantiate(config.source), Path(config.out)
    import torch

    from diffstack_mmv.identification import identification_result, vehicle_provenance
    from diffstack_mmv.plotting import FittedTrack, save_identification
    from diffstack_mmv.reporting import write_identification
    from diffstack_mmv.vehicles import save_vehicle

    name, models = config.names.dynamics, builders(config)
    columns = models[name]().Control._fields
    recordings = recordings_of(config, (source, config.splits, study.spec.mode), columns)
    try:
        result = study(recordings, models)
    except torch.linalg.LinAlgError as singular:
        found = str(singular).splitlines()[0]
        remedy = "Give tracks that turn and are not free of noise, or set `noise`."
        raise ValueError(message("tracks", "inform the problem", found, "", remedy)) from singular
    header = {**config.header, "date": date.today().isoformat()}
    content = identification_result(study, recordings, result)
    write_identification(out, header | content)
    tracks = [FittedTrack(**motion.arrays()) for motion in result.motions()]
    save_identification(out, content, tracks, columns, config.dt_s)
    if len(tracks) < study.tracks:
        logger.warning("%d tracks were fitted, %d were asked for.", len(tracks), study.tracks)
    origin = f"identified from {len(tracks)} tracks of {config.data.name}"
    vehicle = result.calibrated(study.spec, origin)
    save_vehicle(vehicle, out / "vehicle.yaml", vehicle_provenance(header, content, name))


def recordings_of(config: DictConfig, place: tuple[Any, Any, Any], columns: Sequence[str]) -> Any:
    """The tracks of a source and what was recorded beside them; warn of a lag that stays."""
    from diffstack_mmv.data import read_leans, read_recordings, recorded_noise
    from diffstack_mmv.identification import Recordings, lagging_alone

    source, _, mode = place
    motions, leans = read_motions(place, config.dt_s), read_leans(*place)
    driven = driven_tracks(place, columns, motions, config.dt_s) if config.controls else None
    motions, controls = driven or (motions, None)
    noise, parts_of = recorded_noise(source, mode, config.dt_s), read_recordings(source)
    for told in lagging_alone(source.smoother()) if controls is None else ():
        logger.warning(told)
    return Recordings(motions, leans, controls, noise, source.smoother(), parts_of)


def read_motions(place: tuple[Any, Any, Any], dt_s: float) -> dict[str, Any]:
    """The tracks of a source, with velocities that are not those of noise.

    Differences of samples as they are would be: 1.8 m/s for positions within 0.05 m at 25 Hz.
    """
    from data_converters import Unsmoothed, smoother_of
    from diffstack_mmv.data import read_tracks

    motions = read_tracks(*place)
    if not isinstance(smoother_of(place[0].smoother_settings()), Unsmoothed):
        return motions
    return {name: steadied(motion, dt_s) for name, motion in motions.items()}


def steadied(motion: Any, dt_s: float) -> Any:
    """A motion through the same positions, with the velocities of smoothed ones."""
    import numpy as np
    import torch

    from data_converters import ZeroPhaseSmoother
    from diffstack_mmv.data import motion_through

    smoother, time_s = ZeroPhaseSmoother(), dt_s * np.arange(len(motion.heading))
    if len(time_s) < smoother.samples_needed:
        return motion
    smooth = torch.from_numpy(smoother(time_s, motion.position.numpy(), time_s).value)
    return motion_through(smooth, motion.heading, dt_s)._replace(position=motion.position)


def driven_tracks(
    place: tuple[Any, Any, Any], columns: Sequence[str], motions: dict[str, Any], dt_s: float
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Motions and recorded controls that belong together, whatever smoothed the positions."""
    import torch

    from data_converters import CausalSmoother, DrivenTrack, Sampling, matched, smoother_of
    from diffstack_mmv.data import motion_through, read_controls, read_interpolated

    smoother = smoother_of(place[0].smoother_settings())
    lagging = isinstance(smoother, CausalSmoother)
    bridged, moved, controls = read_interpolated(*place), {}, {}
    recorded = read_controls(*place, columns)
    samplings = dict.fromkeys(recorded, Sampling(0.0, dt_s))
    if lagging:
        samplings = track_samplings(place, smoother, recorded, dt_s)
    for name, rows in recorded.items():
        position, gaps = motions[name].position.numpy(), bridged[name].numpy()
        driven = DrivenTrack(position, rows.double().numpy(), gaps)
        track = matched(smoother, driven, dt_s, samplings[name])
        controls[name] = torch.from_numpy(track.controls)
        if lagging:
            position = torch.from_numpy(track.position)
            moved[name] = motion_through(position, motions[name].heading, dt_s)
    return motions | moved, controls


def track_samplings(
    place: tuple[Any, Any, Any], smoother: Any, names: Collection[str], dt_s: float
) -> dict[str, Any]:
    """When each track was sampled; from a row on where the report does not tell."""
    from data_converters import Sampling, from_the_first_sample
    from diffstack_mmv.data import recorded_sampling, recorded_step

    source, _, mode = place
    told = recorded_sampling(source, names)
    found = {name: Sampling(*times) for name, times in told.items()}
    if len(found) < len(names):
        usual = from_the_first_sample(smoother, dt_s, recorded_step(source, mode, dt_s))
        found = dict.fromkeys(names, usual) | found
    return found


def identify_measured(config: DictConfig) -> None:
    """Fit vehicle and instruments, and write vehicle, numbers and tables."""
    from diffstack_mmv.data import read_rides
    from diffstack_mmv.identification import smoothed_beside_instruments
    from diffstack_mmv.identification.measured import (
        measured_remarks,
        measured_result,
        measured_rides,
        measured_tables,
    )
    from diffstack_mmv.reporting import write_tables
    from diffstack_mmv.vehicles import save_vehicle

    study, source, out = measured_study(config), instantiate(config.source), Path(config.out)
    smoothed = smoothed_beside_instruments(source.smoother())
    for told in smoothed:
        logger.warning(told)
    rides = measured_rides(*read_rides(source, config.splits, study.spec.mode))
    result = study(rides, builders(config))
    doubts = measured_remarks(result)
    for told in doubts:
        logger.warning(told)
    header = {**config.header, "date": date.today().isoformat()}
    header |= {"controls": MEASURED, "remarks": smoothed + doubts}
    content = measured_result(study, result, instantiate(config.thresholds))
    write_tables(out, header | content, measured_tables(content))
    vehicle = result.calibrated(study.spec, f"identified from rides of {config.data.name}")
    told = ("tracks", "loss_before", "loss_after", "heldout_before", "heldout_after", "models")
    save_vehicle(vehicle, out / "vehicle.yaml", header | {key: content[key] for key in told})


def measured_study(config: DictConfig) -> Any:
    """The study of measured rides, which finds finished parts of this version of the code alone."""
    study = instantiate(config.measured)
    return replace(study, parts=study.parts.keyed(code_version()))


if __name__ == "__main__":
    main()
