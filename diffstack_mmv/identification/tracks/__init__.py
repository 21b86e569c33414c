"""Segments of recorded tracks: cutting, selecting, splitting; synthetic recordings."""

from diffstack_mmv.identification.tracks.cutting import Recordings, SegmentSettings, cut_tracks
from diffstack_mmv.identification.tracks.excitation import share_beyond_limits
from diffstack_mmv.identification.tracks.segments import SegmentBatch, TrackSegment, stack_segments
from diffstack_mmv.identification.tracks.selection import (
    ExcitationSelection,
    LongestSelection,
    RandomSelection,
    SegmentSelection,
)
from diffstack_mmv.identification.tracks.splitting import (
    DataSplit,
    cross_validation_splits,
    split_segments,
)
from diffstack_mmv.identification.tracks.synthetic import (
    POOR_MANOEUVRES,
    RICH_MANOEUVRES,
    ExcitationManoeuvre,
    MeasurementModel,
    record_manoeuvres,
)

__all__ = [
    "DataSplit",
    "ExcitationManoeuvre",
    "ExcitationSelection",
    "LongestSelection",
    "MeasurementModel",
    "POOR_MANOEUVRES",
    "RICH_MANOEUVRES",
    "RandomSelection",
    "Recordings",
    "SegmentBatch",
    "SegmentSelection",
    "SegmentSettings",
    "TrackSegment",
    "cross_validation_splits",
    "cut_tracks",
    "record_manoeuvres",
    "share_beyond_limits",
    "split_segments",
    "stack_segments",
]
