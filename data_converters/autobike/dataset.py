"""Autobike logs as scenes: one ride each, with controls, sensors and lean beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd

from data_converters.autobike.quality import LogQuality
from data_converters.autobike.reader import Fixes, Log, read_log
from data_converters.multi_agent import MultiAgentDataset, Recording, by_name
from data_converters.recordings import RawScene
from dmmv_conventions.cache import CONTROLS_TABLE, LEAN_TABLE, SENSORS_TABLE, SPLITS
from dmmv_conventions.modes import Mode

UNCLEAN = "unclean"
SENSORS = ("roll_rate", "yaw_rate", "lateral_acceleration")


@dataclass(frozen=True)
class AutobikeDataset(MultiAgentDataset):
    """Logs of the riderless bicycle of Chalmers, positions at 10 Hz and sensors at 100 Hz.

    Beside the agents stand `controls.parquet` with `steer` (rad, of the wheel on the ground),
    `steer_encoder` (rad, about the head axis) and `speed` (m/s, of the wheel), `sensors.parquet`
    with `SENSORS`, and `lean.parquet` (rad, left positive, estimated on board). They are as
    recorded: the zero of the steering differs from run to run, and the wheel is some 3 % fast.

    Attributes:
        root: Folder; every <session>/<n>.csv[.gz] in it and below it is a log.
        split: How whole logs are dealt to the splits.
        quality: What a log must fulfil.
        head_angle_rad: Angle of the head axis to the ground.
        max_speed_mps: Where two positions are further apart than this allows, the receiver stepped,
            and another agent begins.
    """

    name: ClassVar[str] = "autobike"
    location: ClassVar[str] = "gothenburg"
    expects: ClassVar[str] = "logs <session>/<n>.csv[.gz]"

    quality: LogQuality = field(default_factory=LogQuality)
    head_angle_rad: float = 1.2217
    max_speed_mps: float = 6.0

    def settings(self) -> Mapping[str, object]:
        """Split, quality and geometry."""
        own = {"head_angle_rad": self.head_angle_rad, "max_speed_mps": self.max_speed_mps}
        return {**super().settings(), "quality": asdict(self.quality), **own}

    def recordings(self) -> list[Recording]:
        """One per log; known bad ones are read, so that they are counted, but not dealt.

        Raises:
            ConversionError: Two logs have one name.
        """
        paths = [*self.root.glob("**/*/*.csv"), *self.root.glob("**/*/*.csv.gz")]
        bad = {path for path in paths if UNCLEAN in path.relative_to(self.root).parts}
        named = by_name((_recording_name(path), path) for path in sorted(paths))
        return [
            Recording(name, (path,), SPLITS[0] if path in bad else None)
            for name, path in named.items()
        ]

    def table(self, path: Path, recording: Recording, raw: RawScene) -> pd.DataFrame:
        """Positions of one log; its sensors go beside the scene.

        Raises:
            TrackError: If the log cannot be read or its sensors do not agree.
        """
        if self._repeats(path, raw):
            return pd.DataFrame()
        log = read_log(path)
        self.limits.check_samples(log.fixes.time_s, log.fixes.position, path)
        self.quality.check(log, path)
        raw.note("repeated_timestamps", log.repeated)
        raw.note("unusable_values", log.unusable)
        pieces = self._pieces(log.fixes)
        raw.note("position_steps", int(pieces.max()))
        self._add_tables(raw, log, pieces)
        return pd.DataFrame(
            {
                "agent": _names(pieces),
                "mode": float(Mode.BICYCLE),
                "time_s": log.fixes.time_s,
                "x": log.fixes.position[:, 0],
                "y": log.fixes.position[:, 1],
            }
        )

    def _pieces(self, fixes: Fixes) -> np.ndarray:
        """Number (n,) of steps of the receiver before each position."""
        apart = np.hypot(*np.diff(fixes.position, axis=0).T)
        steps = apart > self.max_speed_mps * np.diff(fixes.time_s)
        return np.concatenate([[0], np.cumsum(steps)])

    def _add_tables(self, raw: RawScene, log: Log, pieces: np.ndarray) -> None:
        """Controls, sensors and lean, each row with the agent that the bicycle was at that time."""
        latest = np.searchsorted(log.fixes.time_s, log.time_s, side="right") - 1
        agents = _names(pieces[np.maximum(latest, 0)])
        clock = pd.DataFrame({"agent_id": agents, "time_s": log.time_s})
        sensors = log.sensors.reset_index(drop=True)
        encoder = sensors["steer_encoder"]
        raw.side_tables[CONTROLS_TABLE] = clock.assign(
            steer=np.arctan(np.tan(encoder) * np.sin(self.head_angle_rad)),
            steer_encoder=encoder,
            speed=self.quality.wheel_radius_m * sensors["wheel_speed"],
        )
        raw.side_tables[SENSORS_TABLE] = clock.assign(**{name: sensors[name] for name in SENSORS})
        raw.side_tables[LEAN_TABLE] = clock.assign(lean=sensors["lean"])


def _recording_name(path: Path) -> str:
    """Session and number: "09_06_1" for Test_session_09_06/data_1.csv."""
    number = path.name.partition(".")[0].removeprefix("data_")
    return f"{path.parent.name.removeprefix('Test_session_')}_{number}".replace("-", "_")


def _names(pieces: np.ndarray) -> list[str]:
    return ["bicycle" if number == 0 else f"bicycle_p{number}" for number in pieces.tolist()]
