"""IMPTC: the sequences, the VRU-trajectory release, a sample generator and the download."""

from typing import TYPE_CHECKING

from dmmv_conventions.on_demand import on_demand

if TYPE_CHECKING:
    from data_converters.imptc.dataset import ImptcDataset, SequenceSplit, sequences_at
    from data_converters.imptc.reader import TrackFilter
    from data_converters.imptc.vru import ImptcVruDataset, Overlap

__getattr__ = on_demand(__name__, __file__, "stack")
__all__ = [
    "ImptcDataset",
    "ImptcVruDataset",
    "Overlap",
    "SequenceSplit",
    "TrackFilter",
    "sequences_at",
]
