"""Scenes converted side by side by several processes, which end with the one that began them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import ClassVar

from data_converters.conversion_settings import ConversionSettings
from data_converters.recordings import SceneSource
from data_converters.report import SceneReport
from data_converters.scene_conversion import convert_scene


def converted_scenes(
    settings: ConversionSettings, pending: list[SceneSource]
) -> Iterator[SceneReport]:
    """Convert scenes; at most two per worker are under way, so memory does not grow with them.

    Raises:
        ConversionError: As `convert_scene` does.
    """
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
