"""What is to be said of a data set as a whole: nothing usable, an empty split, no motion."""

import logging
from typing import NoReturn

from data_converters.conversion_settings import ConversionSettings
from data_converters.errors import ConversionError
from data_converters.heading import HeadingSource
from data_converters.report import ConversionReport, SceneReport
from dmmv_conventions.cache import REPORT_FILE
from dmmv_conventions.checks import message

logger = logging.getLogger(__name__)

NEVER_MOVED = HeadingSource.UNKNOWN.name.lower()
"""Rows before the first motion of their agent, in the counts of a scene."""

SHOWN = 5
"""Names of recordings in one message."""


def refuse_all(settings: ConversionSettings, report: ConversionReport) -> NoReturn:
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


def warn_of_empty_splits(reports: list[SceneReport]) -> None:
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


def warn_of_standstill(settings: ConversionSettings, usable: list[SceneReport]) -> None:
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
