"""Converters from recordings to trajdata caches.

Everything a script needs is here; `README.md` describes the cache on disk.
"""

from typing import TYPE_CHECKING

from dmmv_conventions.on_demand import on_demand

if TYPE_CHECKING:
    from data_converters.autobike import AutobikeDataset
    from data_converters.beside import DrivenTrack, matched, smoother_of
    from data_converters.conversion import convert
    from data_converters.conversion_settings import ConversionSettings
    from data_converters.errors import CacheError, ConversionError, RejectReason, TrackError
    from data_converters.eth_ucy import EthUcyDataset
    from data_converters.imptc import ImptcDataset, ImptcVruDataset, SequenceSplit, TrackFilter
    from data_converters.imptc.sample import generate_sample, generate_vru_sample
    from data_converters.lag import from_the_first_sample
    from data_converters.limits import RecordingLimits
    from data_converters.live import LiveTracks
    from data_converters.modes import default_extent
    from data_converters.opening import open_cache
    from data_converters.report import ConversionReport
    from data_converters.sdd import SddDataset
    from data_converters.smoothing import CausalSmoother, Unsmoothed, ZeroPhaseSmoother
    from data_converters.splits import RecordingSplit
    from data_converters.tables import TableColumns, TableDataset, TableUnits
    from data_converters.thab import ThabVruDataset
    from data_converters.tracks import ResampleSettings, Sampling
    from data_converters.two_wheeler import TwoWheelerDataset
    from data_converters.vci import CitrDataset, DutDataset
    from dmmv_conventions.modes import Mode

__getattr__ = on_demand(__name__, __file__, "stack")
__all__ = [
    "AutobikeDataset",
    "CacheError",
    "CausalSmoother",
    "CitrDataset",
    "ConversionError",
    "ConversionReport",
    "ConversionSettings",
    "DrivenTrack",
    "DutDataset",
    "EthUcyDataset",
    "ImptcDataset",
    "ImptcVruDataset",
    "LiveTracks",
    "Mode",
    "RecordingLimits",
    "RecordingSplit",
    "RejectReason",
    "ResampleSettings",
    "Sampling",
    "SddDataset",
    "SequenceSplit",
    "TableColumns",
    "TableDataset",
    "TableUnits",
    "ThabVruDataset",
    "TrackError",
    "TrackFilter",
    "TwoWheelerDataset",
    "Unsmoothed",
    "ZeroPhaseSmoother",
    "convert",
    "default_extent",
    "from_the_first_sample",
    "generate_sample",
    "generate_vru_sample",
    "matched",
    "open_cache",
    "smoother_of",
]
