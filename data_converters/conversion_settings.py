"""What a conversion is set to, and the hashes by which it knows what it has converted before."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from data_converters.errors import require
from data_converters.recordings import RecordingDataset, SceneSource, fingerprint
from data_converters.tracks import ResampleSettings
from dmmv_conventions.cache import FORMAT_VERSION, staging_folder
from dmmv_conventions.checks import require_switch


@dataclass(frozen=True)
class ConversionSettings:
    """What to convert, where to, and how.

    Attributes:
        dataset: The recordings.
        cache: Folder of the cache; several data sets may share it.
        resample: Step, thresholds and smoother of the tracks.
        workers: Processes; 1 converts in this process.
        strict: Raise at the first bad track instead of counting it.
        replace: Let these recordings take the place of others, of another folder, that the cache
            holds under the same name.
        progress: Whether to show a progress bar.

    Raises:
        ConversionError: If `workers` is not positive.
    """

    dataset: RecordingDataset
    cache: Path
    resample: ResampleSettings = field(default_factory=ResampleSettings)
    workers: int = 1
    strict: bool = False
    replace: bool = False
    progress: bool = True

    def __post_init__(self) -> None:
        require(self.workers >= 1, "workers", "be at least 1", self.workers, "", "Give 1.")
        for flag in ("strict", "replace", "progress"):
            require_switch(flag, getattr(self, flag))

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

    def scene_key(self, source: SceneSource) -> str:
        """Hash of all that a converted scene depends on."""
        return _hash([self.digest(), source.name, source.split, source.fingerprint])

    @property
    def staging(self) -> Path:
        """Folder in which the environment grows until it is complete."""
        return staging_folder(self.cache, self.dataset.name, self.digest())


def _hash(content: object) -> str:
    text = json.dumps(content, sort_keys=True, default=str)
    return fingerprint(text.encode())
