"""From recordings to batches of an ego agent and its neighbors, in the frame of the ego."""

from typing import TYPE_CHECKING

from dmmv_conventions.on_demand import on_demand

if TYPE_CHECKING:
    from diffstack_mmv.data.augment import (
        Augmentation,
        Chain,
        Mirror,
        Rotation,
        SpeedScale,
    )
    from diffstack_mmv.data.batch import stack_batch
    from diffstack_mmv.data.corrections import HeldHeading, UpwardY
    from diffstack_mmv.data.datamodule import Splits, TrajdataModule
    from diffstack_mmv.data.dataset import DirectWindows, ExportedWindows, WindowDataset
    from diffstack_mmv.data.export import Export, export_windows
    from diffstack_mmv.data.instruments import (
        read_controls,
        read_leans,
        read_rides,
        read_sensors,
    )
    from diffstack_mmv.data.joined import JoinedWindows, split_windows
    from diffstack_mmv.data.lineage import (
        Recordings,
        joined_recordings,
        other_releases,
        recordings_of,
        require_unseen,
        seen_recordings,
    )
    from diffstack_mmv.data.loading import WindowLoader
    from diffstack_mmv.data.motions import motion_through
    from diffstack_mmv.data.noise import PositionNoise, RecordingNoise
    from diffstack_mmv.data.recorded_scenes import RecordedScenes
    from diffstack_mmv.data.riding import Situations, situations
    from diffstack_mmv.data.sampling import Balance, EqualModes, SituationShare
    from diffstack_mmv.data.settings import ExportSettings, LoaderSettings, WindowSettings
    from diffstack_mmv.data.sources import ConvertedCache, NamedDataset, WindowSource
    from diffstack_mmv.data.tracks import (
        read_interpolated,
        read_recordings,
        read_tracks,
        recorded_noise,
        recorded_sampling,
        recorded_step,
    )

__getattr__ = on_demand(__name__, __file__, "stack")
__all__ = [
    "Augmentation",
    "Balance",
    "Chain",
    "ConvertedCache",
    "DirectWindows",
    "EqualModes",
    "Export",
    "ExportSettings",
    "ExportedWindows",
    "HeldHeading",
    "JoinedWindows",
    "LoaderSettings",
    "Mirror",
    "NamedDataset",
    "PositionNoise",
    "RecordedScenes",
    "RecordingNoise",
    "Recordings",
    "Rotation",
    "SituationShare",
    "Situations",
    "SpeedScale",
    "Splits",
    "TrajdataModule",
    "UpwardY",
    "WindowDataset",
    "WindowLoader",
    "WindowSettings",
    "WindowSource",
    "export_windows",
    "joined_recordings",
    "motion_through",
    "other_releases",
    "read_controls",
    "read_interpolated",
    "read_leans",
    "read_recordings",
    "read_rides",
    "read_sensors",
    "read_tracks",
    "recorded_noise",
    "recorded_sampling",
    "recorded_step",
    "recordings_of",
    "require_unseen",
    "seen_recordings",
    "situations",
    "split_windows",
    "stack_batch",
]
