"""Conversion of a data set into a trajdata cache: parallel, resumable, whole or not at all."""

from __future__ import annotations

import json
import logging
import os
import shutil
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any, ClassVar

from tqdm import tqdm

from data_converters.cache import SCENE_REPORT_FILE, write_json, write_scene
from data_converters.errors import ConversionError, TrackError, fault, require
from data_converters.recordings import RawScene, RecordingDataset, SceneSource, fingerprint
from data_converters.report import ConversionReport, SceneReport, report_scene
from data_converters.tracks import AgentRows, ResampleSettings, resample, split_at_gaps
from dmmv_conventions.cache import FORMAT_VERSION, REPORT_FILE, STATE_FILE, staging_folder
from dmmv_conventions.disk import disk_is_full
from dmmv_conventions.locks import in_turn

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ConversionSettings:
    """What to convert, where to, and how.

    Attributes:
        dataset: The recordings.
        cache: Folder of the cache; several data sets may share it.
        resample: Step, thresholds and smoother of the tracks.
        workers: Processes; 1 converts in this process.
        strict: Raise at the first bad track instead of counting it.
        progress: Whether to show a progress bar.

    Raises:
        ConversionError: If `workers` is not positive.
    """

    dataset: RecordingDataset
    cache: Path
    resample: ResampleSettings = field(default_factory=ResampleSettings)
    workers: int = 1
    strict: bool = False
    progress: bool = True

    def __post_init__(self) -> None:
        require(self.workers >= 1, "workers", "be at least 1", self.workers, "", "Give 1.")

    def content(self) -> dict[str, Any]:
        """The settings that change the cache, as plain values."""
        smoother = self.resample.smoother
        return {
            "format_version": FORMAT_VERSION,
            "dataset": {"name": self.dataset.name, **self.dataset.settings()},
            "limits": asdict(self.dataset.limits),
            "resample": {**asdict(self.resample), "smoother": smoother.settings()},
        }

    def digest(self) -> str:
        """Hash of `content`, 16 hexadecimal digits."""
        return _hash(self.content())

    @property
    def staging(self) -> Path:
        """Folder in which the environment grows until it is complete."""
        return staging_folder(self.cache, self.dataset.name, self.digest())


def convert(settings: ConversionSettings) -> ConversionReport:
    """Convert a data set; the environment appears in the cache only when it is complete.

    Scenes grow in a hidden folder next to it. A later call with equal settings goes on where an
    earlier one stopped, and reuses scenes of a finished cache whose files and settings are equal.
    An earlier environment stays as it is until the new one takes its place.

    Returns:
        The report, also written to `cache`/`name`/conversion_report.json and, for the latest
        conversion, to `cache`/conversion_report.json.

    Raises:
        ConversionError: If the data set is missing or holds no usable track, the disk is full, or,
            when strict, a track is bad.
    """
    try:
        sources = settings.dataset.scenes()
        with in_turn(settings.cache, settings.dataset.name):
            settings.staging.mkdir(parents=True, exist_ok=True)
            reports = _convert_scenes(settings, sources)
            return _finish(settings, reports)
    except OSError as error:
        if not disk_is_full(error):
            raise
        remedy = "Free space and run the same command again: finished scenes are kept."
        raise ConversionError(
            fault("cache", "have free disk space", error.strerror, settings.cache, remedy)
        ) from error


def _convert_scenes(settings: ConversionSettings, sources: list[SceneSource]) -> list[SceneReport]:
    done: dict[str, SceneReport] = {}
    pending: list[SceneSource] = []
    for source in sources:
        report = _finished_scene(settings, source)
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

    @classmethod
    def convert(cls, source: SceneSource) -> SceneReport:
        return convert_scene(cls.settings, source)


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
    key = _scene_key(settings, source)
    report = report_scene(source.name, source.split, key, raw, agents, dt_s)
    partial = settings.staging / f".partial_{source.name}_{os.getpid()}"
    name = settings.dataset.name
    try:
        folder = partial / name / source.name
        folder.mkdir(parents=True, exist_ok=True)
        if agents:
            metadata = environment(name, dt_s, {source.name: source.split})
            write_scene(partial, metadata, source.name, settings.dataset.location, agents, raw)
        write_json(folder / SCENE_REPORT_FILE, asdict(report))
        target = settings.staging / source.name
        shutil.rmtree(target, ignore_errors=True)
        os.replace(folder, target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return report


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
    for track in raw.tracks:
        for stretch in split_at_gaps(track, settings.resample.max_gap_s):
            try:
                rows = resample(stretch, settings.resample)
                settings.dataset.limits.check_rows(rows, track.source)
                agents.append(rows)
            except TrackError as error:
                raw.reject(stretch.name, track.source, error, strict=settings.strict)
    return sorted(agents, key=lambda agent: agent.name)


def _finished_scene(settings: ConversionSettings, source: SceneSource) -> SceneReport | None:
    """The report of a scene that stands in the staging folder, or could be copied there."""
    key = _scene_key(settings, source)
    staged = settings.staging / source.name
    earlier = settings.cache / settings.dataset.name / source.name
    for folder in (staged, earlier):
        path = folder / SCENE_REPORT_FILE
        if not path.is_file():
            continue
        report = SceneReport(**json.loads(path.read_text(encoding="utf-8")))
        if report.key != key or not report.current:
            continue
        if folder != staged:
            partial = settings.staging / f".partial_{source.name}"
            shutil.rmtree(partial, ignore_errors=True)
            shutil.copytree(folder, partial)
            os.replace(partial, staged)
        return report
    return None


def _finish(settings: ConversionSettings, reports: list[SceneReport]) -> ConversionReport:
    """Write lists and reports, then put the environment in its place.

    Raises:
        ConversionError: If no scene holds an agent.
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
    found = f"0 of {sum(s.tracks_read for s in reports)} ({report.rejected_by_reason})"
    remedy = "See the reasons; `strict` shows the first fault."
    require(bool(usable), "root", "hold a usable track", found, settings.dataset.root, remedy)
    from trajdata.caching.env_cache import EnvCache

    location = settings.dataset.location
    listed = [(s.name, location, s.split, s.steps, i) for i, s in enumerate(usable)]
    for leftover in settings.staging.glob(".partial_*"):  # of a process that was killed
        shutil.rmtree(leftover, ignore_errors=True)
    EnvCache(settings.staging).save_env_scenes_list(".", listed)  # type: ignore[arg-type]
    write_json(settings.staging / REPORT_FILE, report.as_dict())
    write_json(settings.staging / STATE_FILE, _state(settings, usable))
    _replace_folder(settings.staging, settings.cache / name)
    write_json(settings.cache / REPORT_FILE, report.as_dict())
    return report


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


def _scene_key(settings: ConversionSettings, source: SceneSource) -> str:
    return _hash([settings.digest(), source.name, source.split, source.fingerprint])


def _hash(content: object) -> str:
    text = json.dumps(content, sort_keys=True, default=str)
    return fingerprint(text.encode())
