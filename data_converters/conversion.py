"""Conversion of a data set into a trajdata cache: parallel, resumable, whole or not at all."""

from __future__ import annotations

import logging
import os
import shutil
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tqdm import tqdm

from data_converters.cache import write_json
from data_converters.conversion_settings import ConversionSettings
from data_converters.errors import ConversionError, fault
from data_converters.origin import require_same_origin, write_origin
from data_converters.recordings import SceneSource
from data_converters.remarks import refuse_all, warn_of_empty_splits, warn_of_standstill
from data_converters.report import ConversionReport, SceneReport
from data_converters.scene_conversion import finished_scene
from data_converters.workers import converted_scenes
from dmmv_conventions.cache import FORMAT_VERSION, REPORT_FILE, STATE_FILE
from dmmv_conventions.checks import message
from dmmv_conventions.disk import disk_is_full
from dmmv_conventions.locks import in_turn

logger = logging.getLogger(__name__)


def convert(settings: ConversionSettings) -> ConversionReport:
    """Convert a data set; the environment appears in the cache only when it is complete.

    Scenes grow in a hidden folder next to it. A later call with equal settings goes on where an
    earlier one stopped, and reuses scenes of a finished cache whose files and settings are equal.
    An earlier environment stays as it is until the new one takes its place; one that was made from
    another folder is only replaced by the same recordings, or with `replace`.

    Returns:
        The report, also written to `cache`/`name`/conversion_report.json and, for the latest
        conversion, to `cache`/conversion_report.json.

    Raises:
        ConversionError: If the data set is missing or holds no usable track, the cache holds other
            recordings under its name, the disk is full, or, when strict, a track is bad, also one
            that an earlier conversion counted.
    """
    try:
        sources = settings.dataset.scenes()
        with in_turn(settings.cache, settings.dataset.name):
            require_same_origin(settings, sources)
            settings.staging.mkdir(parents=True, exist_ok=True)
            write_origin(settings, sources)
            reports = _convert_scenes(settings, sources)
            return _finish(settings, sources, reports)
    except OSError as error:
        told = _told_of_cache(error, settings.cache)
        if not told:
            raise
        raise ConversionError(told) from error


def _told_of_cache(error: OSError, cache: Path) -> str:
    """The message for a folder of the cache that cannot be written, "" for any other failure."""
    if disk_is_full(error):
        remedy = (
            "Free space, or raise your limit, and run the same command again: finished scenes are "
            "kept."
        )
        return fault("cache", "have free disk space", error.strerror, cache, remedy)
    # locks tell the whole path of their file
    place, cache = Path(error.filename or "").absolute(), cache.absolute()
    above = cache.is_relative_to(place) and not place.is_dir()
    if error.filename and (place.is_relative_to(cache) or above):
        needs = "be a folder that can be written"
        return message("cache", needs, f"'{place}' ({error.strerror})", "", "Give another one.")
    return ""


def _convert_scenes(settings: ConversionSettings, sources: list[SceneSource]) -> list[SceneReport]:
    done: dict[str, SceneReport] = {}
    pending: list[SceneSource] = []
    for source in sources:
        report = finished_scene(settings, source)
        if report is None:
            pending.append(source)
        else:
            done[source.name] = report
    if done:
        logger.info("%d of %d scenes are already converted", len(done), len(sources))
    bar = tqdm(
        total=len(sources),
        initial=len(done),
        desc=f"convert {settings.dataset.name}",
        unit="scene",
        disable=not settings.progress,
    )
    with bar:
        for report in converted_scenes(settings, pending):
            done[report.name] = report
            bar.update()
    return [done[source.name] for source in sources]


def _finish(
    settings: ConversionSettings, sources: list[SceneSource], reports: list[SceneReport]
) -> ConversionReport:
    """Write lists and reports, then put the environment in its place.

    Raises:
        ConversionError: If no scene holds an agent; the report is written all the same.
    """
    name = settings.dataset.name
    report = ConversionReport(
        dataset=name,
        settings=settings.content(),
        settings_hash=settings.digest(),
        versions={package: version(package) for package in ("trajdata", "scipy", "numpy")},
        scenes=reports,
        dataset_notes=dict(settings.dataset.notes()),
    )
    usable = [scene for scene in reports if scene.usable]
    if not usable:
        write_json(settings.cache / REPORT_FILE, report.as_dict())
        refuse_all(settings, report)
    warn_of_empty_splits(reports)
    warn_of_standstill(settings, usable)
    from trajdata.caching.env_cache import EnvCache

    location = settings.dataset.location
    listed = [(s.name, location, s.split, s.steps, i) for i, s in enumerate(usable)]
    _remove_leftovers(settings.staging, {scene.name for scene in reports})
    EnvCache(settings.staging).save_env_scenes_list(".", listed)  # type: ignore[arg-type]
    write_json(settings.staging / REPORT_FILE, report.as_dict())
    write_json(settings.staging / STATE_FILE, _state(settings, sources, usable))
    _replace_folder(settings.staging, settings.cache / name)
    write_json(settings.cache / REPORT_FILE, report.as_dict())
    return report


def _remove_leftovers(staging: Path, scenes: set[str]) -> None:
    """Remove what a killed process left, also scenes of recordings that are there no longer."""
    for folder in staging.iterdir():
        if folder.is_dir() and folder.name not in scenes:
            shutil.rmtree(folder, ignore_errors=True)


def _state(
    settings: ConversionSettings, sources: list[SceneSource], usable: list[SceneReport]
) -> dict[str, Any]:
    named = {source.name: source.recording for source in sources}
    own = {name: {"recording": whole} for name, whole in named.items() if whole not in ("", name)}
    return {
        "format_version": FORMAT_VERSION,
        "dataset": settings.dataset.name,
        "dt_s": settings.resample.dt_s,
        "settings_hash": settings.digest(),
        "complete": True,
        "smoother": settings.resample.smoother.settings(),
        "location": settings.dataset.location,
        "scenes": [
            {"name": s.name, "split": s.split, "steps": s.steps, "agents": s.agents}
            | own.get(s.name, {})
            for s in usable
        ],
    }


def _replace_folder(new: Path, place: Path) -> None:
    old = place.with_name(f".replaced_{place.name}")
    shutil.rmtree(old, ignore_errors=True)
    if place.exists():
        os.replace(place, old)
    os.replace(new, place)
    shutil.rmtree(old, ignore_errors=True)
