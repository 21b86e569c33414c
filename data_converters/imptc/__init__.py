"""IMPTC: the sequences, the VRU-trajectory release, a sample generator and the download."""

from data_converters.imptc.dataset import ImptcDataset, SequenceSplit, sequences_at
from data_converters.imptc.reader import TrackFilter
from data_converters.imptc.vru import ImptcVruDataset, Overlap

__all__ = [
    "ImptcDataset",
    "ImptcVruDataset",
    "Overlap",
    "SequenceSplit",
    "TrackFilter",
    "sequences_at",
]
