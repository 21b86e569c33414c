"""The rows of one scene of trajdata 1.4.0, read once."""

import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from trajdata.augmentation.augmentation import DatasetAugmentation
from trajdata.caching.df_cache import STATE_FORMAT_STR, DataFrameCache
from trajdata.data_structures.agent import AgentMetadata
from trajdata.data_structures.scene_metadata import Scene
from trajdata.data_structures.state import StateArray

from diffstack_mmv.data.damage import told_as_damage


class SceneTable(DataFrameCache):
    """The rows of one scene, opened once for all its windows.

    Single states are read from an array: two thirds of the time of the base class go into asking
    pandas for them.
    """

    def __init__(
        self,
        cache_path: Path,
        scene: Scene,
        corrections: Sequence[DatasetAugmentation],
        remedy: str,
    ) -> None:
        """Read the rows of `scene` and apply `corrections` to them.

        Raises:
            ValueError: A file is missing or damaged; `remedy` says how to make it anew.
        """
        self._remedy = remedy
        super().__init__(cache_path, scene, list(corrections))
        # one block of memory instead of one per column
        self.scene_data_df = self.scene_data_df.copy()
        self._states = self.scene_data_df.iloc[:, : self._state_dim].to_numpy()

    def _load_agent_data(self, scene_dt: float) -> None:
        """Read both files as the base class does, so that the damaged one is named."""
        rows = self.scene_dir / self._agent_data_file(scene_dt)
        index = self.scene_dir / self._agent_data_index_file(scene_dt)
        with told_as_damage(rows, self._remedy):
            table = pd.read_feather(rows, use_threads=False)
            self.scene_data_df = table.set_index(["agent_id", "scene_ts"])
            self._get_and_reorder_col_idxs()
        with told_as_damage(index, self._remedy):
            self.index_dict = pickle.loads(index.read_bytes())

    def get_raw_state(self, agent_id: str, scene_ts: int) -> StateArray:
        """State of an agent at one time, in the world."""
        state = self._states[self.index_dict[agent_id, scene_ts]].copy()
        return StateArray.from_array(state, STATE_FORMAT_STR)

    def get_states(self, agent_ids: list[str], scene_ts: int) -> StateArray:
        """States (agents, 5) of some agents at one time, as observed: x, y, velocity, heading."""
        rows = [self.index_dict[agent_id, scene_ts] for agent_id in agent_ids]
        return self._observation(self._states[rows])

    def get_agents_future(
        self,
        scene_ts: int,
        agents: list[AgentMetadata],
        history_sec: tuple[float | None, float | None],
    ) -> tuple[list[Any], list[NDArray[np.float64]], NDArray[np.int64]]:
        """Futures (steps, 5), extents (steps, 3) in m and lengths, neighbor by neighbor.

        There is none for one that ends now, of whom trajdata repeats the present.
        """
        futures, extents, lengths = super().get_agents_future(scene_ts, agents, history_sec)
        ongoing = np.array([agent.last_timestep > scene_ts for agent in agents], dtype=bool)
        kept = [
            (future if alive else future[:0], extent if alive else extent[:0])
            for future, extent, alive in zip(futures, extents, ongoing, strict=True)
        ]
        return [future for future, _ in kept], [extent for _, extent in kept], lengths * ongoing
