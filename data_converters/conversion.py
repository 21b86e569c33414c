"""Conversion of a data set into a trajdata cache: parallel, resumable, whole or not at all."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from importlib.metadata import version
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any, ClassVar, NoReturn

from tqdm import tqdm

from data_converters.cache import write_json
from data_converters.conversion_settings import ConversionSettings
from data_converters.errors import ConversionError, fault
from data_converters.heading import HeadingSource
from data_converters.origin import require_same_origin, write_origin
from data_converters.recordings import SceneSource
from data_converters.report import ConversionReport, SceneReport
from data_converters.scene_conversion import convert_scene, finished_scene
from dmmv_conventions.cache import FORMAT_VERSION, REPORT_FILE, STATE_FILE
from dmmv_conventions.checks import message
from dmmv_conventions.disk import disk_is_full
from dmmv_conventions.locks import in_turn

logger = logging.getLogger(__name__)

NEVER_MOVED = HeadingSource.UNKNOWN.name.lower()
"""Rows before the first motion of their agent, in the counts of a scene."""

SHOWN = 5
"""Names of recordings in one message."""


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
            return _finish(settings, reports)
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
        for report in _run(settings, pending):
            done[report.name] = report
            bar.update()
    return [done[source.name] for source in sources]


def _run(settings: ConversionSettings, pending: list[SceneSource]) -> Iterator[SceneReport]:
    """Convert scenes; at most two per worker are under way, so memory does not grow with them."""
    if settings.workers == 1:
        for source in pending:
            yield convert_scene(settings, source)
        return
    import trajdata  # noqa: F401  before the workers are forked, which then share it

    todo = iter(pending)
    running: set[Future[SceneReport]] = set()
    pool = ProcessPoolExecutor(
        settings.workers,
        mp_context=get_context("fork"),
        initializer=_WorkerSettings.keep,
        initargs=(settings,),
    )
    with pool:
        try:
            for source in todo:
                running.add(pool.submit(_WorkerSettings.convert, source))
                if len(running) >= 2 * settings.workers:
                    finished, running = wait(running, return_when=FIRST_COMPLETED)
                    yield from (future.result() for future in finished)
            while running:
                finished, running = wait(running, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in finished)
        finally:
            pool.shutdown(cancel_futures=True)


class _WorkerSettings:
    """The settings of a forked worker, inherited once: a data set may hold all its tracks."""

    settings: ClassVar[ConversionSettings]

    @classmethod
    def keep(cls, settings: ConversionSettings) -> None:
        cls.settings = settings
        Thread(target=_end_with_parent, daemon=True).start()

    @classmethod
    def convert(cls, source: SceneSource) -> SceneReport:
        return convert_scene(cls.settings, source)


def _end_with_parent() -> None:
    """End this worker once its parent is gone: killed, it tells nobody, who would wait for ever."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _finish(settings: ConversionSettings, reports: list[SceneReport]) -> ConversionReport:
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
        _refuse_all(settings, report)
    _warn_of_empty_splits(reports)
    _warn_of_standstill(settings, usable)
    from trajdata.caching.env_cache import EnvCache

    location = settings.dataset.location
    listed = [(s.name, location, s.split, s.steps, i) for i, s in enumerate(usable)]
    _remove_leftovers(settings.staging, {scene.name for scene in reports})
    EnvCache(settings.staging).save_env_scenes_list(".", listed)  # type: ignore[arg-type]
    write_json(settings.staging / REPORT_FILE, report.as_dict())
    write_json(settings.staging / STATE_FILE, _state(settings, usable))
    _replace_folder(settings.staging, settings.cache / name)
    write_json(settings.cache / REPORT_FILE, report.as_dict())
    return report


def _remove_leftovers(staging: Path, scenes: set[str]) -> None:
    """Remove what a killed process left, also scenes of recordings that are there no longer."""
    for folder in staging.iterdir():
        if folder.is_dir() and folder.name not in scenes:
            shutil.rmtree(folder, ignore_errors=True)


def _refuse_all(settings: ConversionSettings, report: ConversionReport) -> NoReturn:
    """Refuse a data set without a usable track, with the first fault of its tracks.

    Raises:
        ConversionError: Always.
    """
    faults = [item["detail"] for scene in report.scenes for item in scene.rejected]
    tracks = sum(scene.tracks_read for scene in report.scenes)
    found = f"0 of {tracks} ({report.rejected_by_reason})"
    remedy = f"All are in {settings.cache / REPORT_FILE}."
    if faults:
        remedy = f"The first fault: {faults[0]} {remedy}"
    where = f"in {settings.dataset.root}"
    raise ConversionError(message("root", "hold a usable track", found, where, remedy))


def _warn_of_empty_splits(reports: list[SceneReport]) -> None:
    """Say which splits lost all they should hold: nothing can be trained or measured there."""
    kept = {scene.split for scene in reports if scene.usable}
    for split in sorted({scene.split for scene in reports} - kept):
        names = [scene.name for scene in reports if scene.split == split]
        shown = ", ".join(names[:SHOWN]) + (", ..." if len(names) > SHOWN else "")
        logger.warning(
            "The split '%s' holds no agent, because nothing in its recordings can be used: %s. "
            "Correct them, or move them away: recordings that are dealt are then dealt anew.",
            split,
            shown,
        )


def _warn_of_standstill(settings: ConversionSettings, usable: list[SceneReport]) -> None:
    """Say that nobody moves: positions in m, read as mm, look like that."""
    slow_mps = settings.resample.standstill_mps
    if all(_stands(scene, slow_mps) for scene in usable):
        fastest = max(scene.fastest_mps or 0.0 for scene in usable)
        logger.warning(
            "No agent of '%s' ever moves faster than %g m/s (the fastest: %.2g m/s). "
            "Positions are read as %s: check their unit.",
            *(settings.dataset.name, slow_mps, fastest, settings.dataset.unit_of_positions),
        )


def _stands(scene: SceneReport, slow_mps: float) -> bool:
    """Whether nobody in a scene moves; an earlier report tells it of headings alone."""
    if scene.fastest_mps is None:
        return scene.heading_rows.get(NEVER_MOVED) == scene.rows
    return scene.fastest_mps < slow_mps


def _state(settings: ConversionSettings, usable: list[SceneReport]) -> dict[str, Any]:
    return {
        "format_version": FORMAT_VERSION,
        "dataset": settings.dataset.name,
        "dt_s": settings.resample.dt_s,
        "settings_hash": settings.digest(),
        "complete": True,
        "smoother": settings.resample.smoother.settings(),
        "location": settings.dataset.location,
        "scenes": [
            {"name": s.name, "split": s.split, "steps": s.steps, "agents": s.agents} for s in usable
        ],
    }


def _replace_folder(new: Path, place: Path) -> None:
    old = place.with_name(f".replaced_{place.name}")
    shutil.rmtree(old, ignore_errors=True)
    if place.exists():
        os.replace(place, old)
    os.replace(new, place)
    shutil.rmtree(old, ignore_errors=True)
