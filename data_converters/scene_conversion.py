"""Conversion of one scene, which appears in the staging folder when it is complete."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import asdict
from pathlib import Path

from data_converters.cache import SCENE_REPORT_FILE, write_json, write_scene
from data_converters.conversion_settings import ConversionSettings
from data_converters.errors import TrackError
from data_converters.recordings import RawScene, SceneSource, fingerprint_of
from data_converters.report import SceneReport, report_scene
from data_converters.resampling import resample
from data_converters.tracks import AgentRows, split_at_gaps

FILES = "files"
"""Key of the report of a scene under which the hashes of its files stand."""


def convert_scene(settings: ConversionSettings, source: SceneSource) -> SceneReport:
    """Convert one scene into the staging folder; its folder appears there when it is complete.

    Raises:
        ConversionError: If the scene cannot be read, or, when strict, one of its tracks.
    """
    from dmmv_conventions.opening import environment

    dt_s = settings.resample.dt_s
    raw = settings.dataset.read(source, dt_s, strict=settings.strict)
    _reject_implausible(raw, settings)
    agents = _resample_all(raw, settings)
    key = settings.scene_key(source)
    report = report_scene(source.name, source.split, key, raw, agents, dt_s)
    partial = settings.staging / f".partial_{source.name}_{os.getpid()}"
    name = settings.dataset.name
    try:
        folder = partial / name / source.name
        folder.mkdir(parents=True, exist_ok=True)
        if agents:
            metadata = environment(name, dt_s, {source.name: source.split})
            write_scene(partial, metadata, source.name, settings.dataset.location, agents, raw)
        content = {**asdict(report), FILES: _files(folder)}
        write_json(folder / SCENE_REPORT_FILE, content)
        target = settings.staging / source.name
        shutil.rmtree(target, ignore_errors=True)
        os.replace(folder, target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return report


def finished_scene(settings: ConversionSettings, source: SceneSource) -> SceneReport | None:
    """The report of a scene that stands in the staging folder, or could be copied there.

    A scene of which a file is lost or damaged counts as not converted. When strict, so does one
    with a rejected track: reading it again raises the fault of the track, but for tracks that are
    left out on purpose.
    """
    key = settings.scene_key(source)
    staged = settings.staging / source.name
    earlier = settings.cache / settings.dataset.name / source.name
    for folder in (staged, earlier):
        report = _intact(folder)
        if report is None or report.key != key or (settings.strict and report.rejected):
            continue
        if folder != staged:
            partial = settings.staging / f".partial_{source.name}"
            shutil.rmtree(partial, ignore_errors=True)
            shutil.copytree(folder, partial)
            shutil.rmtree(staged, ignore_errors=True)
            os.replace(partial, staged)
        return report
    return None


def _intact(folder: Path) -> SceneReport | None:
    """The report of a scene; None if it is of an earlier version, or a file is not as written."""
    try:
        content = json.loads((folder / SCENE_REPORT_FILE).read_text(encoding="utf-8"))
        written = content.pop(FILES)
        report = SceneReport(**content)
        # tables of one's own may stand beside them
        whole = report.current and written.items() <= _files(folder).items()
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
    return report if whole else None


def _files(folder: Path) -> dict[str, str]:
    """Hash of each file of a scene by its name, without the report."""
    paths = sorted(path for path in folder.iterdir() if path.name != SCENE_REPORT_FILE)
    return {path.name: fingerprint_of(path) for path in paths}


def _reject_implausible(raw: RawScene, settings: ConversionSettings) -> None:
    """Leave out tracks that no recording can hold, before anything is made of them."""
    dataset, kept = settings.dataset, []
    for track in raw.tracks:
        try:
            dataset.limits.check(track, dataset.origin_m, settings.resample.dt_s)
            kept.append(track)
        except TrackError as error:
            raw.reject(track.name, track.source, error, strict=settings.strict)
    raw.tracks[:] = kept


def _resample_all(raw: RawScene, settings: ConversionSettings) -> list[AgentRows]:
    agents = []
    # tables beside the scene may hold agents that were rejected, too
    taken = {each.name for each in raw.tracks} | {each.track for each in raw.rejected}
    for track in raw.tracks:
        for stretch in split_at_gaps(track, settings.resample.max_gap_s, taken):
            try:
                rows = resample(stretch, settings.resample)
                settings.dataset.limits.check_rows(rows, track.source)
                agents.append(rows)
            except TrackError as error:
                raw.reject(stretch.name, track.source, error, strict=settings.strict)
    return sorted(agents, key=lambda agent: agent.name)
