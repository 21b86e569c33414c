"""Whole recorded scenes, everybody in them at once, for a replay."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from diffstack_mmv.checks import require
from diffstack_mmv.data.converted import agent_rows, converted, scene_of
from diffstack_mmv.data.motions import STANDSTILL_MPS, yaw_rate
from diffstack_mmv.data.sources import ConvertedCache
from diffstack_mmv.geometry import rotate
from diffstack_mmv.types import Motion, RecordedScene, Tracks

COLUMNS = ["x", "y", "vx", "vy", "heading"]


@dataclass(frozen=True)
class RecordedScenes:
    """The scenes of a converted cache, as a replay wants them.

    Attributes:
        source: The cache.
    """

    source: ConvertedCache

    def duration_s(self, split: str) -> dict[str, float]:
        """Length in s of every scene of a split, by its name.

        Args:
            split: Split of the data set.

        Raises:
            ValueError: The cache cannot be used, or has no scene in the split.
        """
        scenes, dt_s = self.source.scenes(), self.source.dt_s()
        found = {s["name"]: (s["steps"] - 1) * dt_s for s in scenes if s["split"] == split}
        splits = sorted({scene["split"] for scene in scenes})
        wanted = f"be one of {', '.join(splits)}"
        require(len(found) > 0, "phase", wanted, f"'{split}'", f"for '{self.source.name}'")
        return found

    def read(self, name: str) -> RecordedScene:
        """Everybody in a scene, padded to its whole length, in the world of the recording.

        Args:
            name: Name of the scene.

        Raises:
            ValueError: Another user wrote the cache, or a file of the scene is missing or damaged.
        """
        cache = converted(self.source)
        return _read(cache.name, cache.folder, name)


@lru_cache(maxsize=64)
def _read(dataset: str, folder: str, name: str) -> RecordedScene:
    """The agents of a scene; rows in which one is absent are zero."""
    cache = ConvertedCache(dataset, folder)
    scene, table = scene_of(cache, name), agent_rows(cache, name)
    agents = {agent.name: number for number, agent in enumerate(scene.agents or ())}
    number = table["agent_id"].map(agents).to_numpy()
    rows = np.zeros((len(agents), scene.length_timesteps, len(COLUMNS)))
    valid = np.zeros(rows.shape[:2], dtype=bool)
    rows[number, table["scene_ts"]] = table[COLUMNS].to_numpy("float64")
    valid[number, table["scene_ts"]] = True
    boxes: list[Any] = [agent.extent for agent in scene.agents or ()]
    sizes = [(box.length, box.width) for box in boxes]
    state = torch.from_numpy(rows)
    velocity, heading = state[..., 2:4], state[..., 4]
    moving = velocity.norm(dim=-1) >= STANDSTILL_MPS
    motion = Motion(
        position=state[..., :2],
        heading=heading,
        velocity=rotate(velocity, -heading),
        yaw_rate=yaw_rate(heading, moving, scene.dt),
    )
    tracks = Tracks(
        motion=motion,
        extent=torch.tensor(sizes, dtype=torch.float64).reshape(-1, 2),
        mode=torch.tensor([int(agent.type) for agent in scene.agents or ()]),
        valid=torch.from_numpy(valid),
    )
    return RecordedScene(tracks, scene.dt)
