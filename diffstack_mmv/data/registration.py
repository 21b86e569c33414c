"""Windows of trajdata 1.4.0.

This, `scene_table.py` and `dmmv_conventions.opening` alone know its inside.
"""

from collections.abc import Mapping, Sequence
from math import isclose
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from trajdata.augmentation.augmentation import DatasetAugmentation
from trajdata.caching.df_cache import STATE_FORMAT_STR
from trajdata.caching.env_cache import EnvCache
from trajdata.data_structures.batch_element import AgentBatchElement
from trajdata.data_structures.scene import SceneTimeAgent
from trajdata.data_structures.scene_metadata import Scene
from trajdata.dataset_specific.raw_dataset import RawDataset
from trajdata.utils import scene_utils

from diffstack_mmv.data.damage import told_as_damage
from diffstack_mmv.data.scene_table import SceneTable
from diffstack_mmv.data.settings import WindowSettings
from diffstack_mmv.data.window_counts import WindowCounts
from dmmv_conventions.cache import conversion_of
from dmmv_conventions.opening import CachedUnifiedDataset, encoded

OBSERVED = "x,y,xd,yd,h"
EXACT_FRAME = "agent_from_world"
"""Of the extras of an element: the transformation into its frame (3, 3), which trajdata rounds."""


class WindowLocation(NamedTuple):
    """Where windows are, one entry each."""

    element: NDArray[np.int64]  # index into the data set
    scene: list[str]
    agent: list[str]
    row: NDArray[np.int64]  # time index of the present within the scene
    mode: NDArray[np.int64]
    recording: list[str]  # that the scene is part of


class _OpenScene(NamedTuple):
    path: str
    scene: Scene
    table: SceneTable


class _OneRadius(dict[Any, float]):
    """The same interaction distance in m for every pair of modes."""

    def __init__(self, radius_m: float) -> None:
        super().__init__()
        self.radius_m = radius_m

    def __missing__(self, pair: object) -> float:
        return self.radius_m


class _Step(float):
    """A step in s that is a whole number of recorded ones, in spite of rounding.

    trajdata asks for an exact ratio, while no float divided by 0.1 is 3.
    """

    def __truediv__(self, recorded_s: float) -> float:
        ratio = float(self) / recorded_s
        return float(round(ratio)) if isclose(ratio, round(ratio), rel_tol=1e-6) else ratio


class TrajdataWindows(CachedUnifiedDataset):
    """Agent-centric windows of one split; item i is trajdata's element for one agent at one time.

    Unlike the base class it keeps the scene of the last item open, because trajdata reads the whole
    scene from disk at each access.
    """

    def __init__(
        self,
        query: str,
        windows: WindowSettings,
        cache: Path,
        environments: Sequence[RawDataset] = (),
        raw_folders: Mapping[str, str] | None = None,
        corrections: Sequence[DatasetAugmentation] = (),
        recordings: Mapping[str, str] | None = None,
    ) -> None:
        """Open the scenes whose tags match `query`.

        Args:
            query: Environment and split, joined by "-".
            windows: What a sample is.
            cache: Folder of trajdata's cache.
            environments: Converted data sets; none if trajdata itself knows the data set.
            raw_folders: Folder of the recordings of each data set that trajdata itself knows.
            corrections: Repairs applied to each scene that is opened.
            recordings: Recording that a scene is part of, by its name; else the scene is one.
        """
        self._opened: _OpenScene | None = None
        self._modes: list[list[int]] = []
        self._corrections = tuple(corrections)
        self._recordings = dict(recordings or {})
        self.windows = windows
        self._remedies = {each.name: conversion_of(each.name, cache) for each in environments}
        self.counts = WindowCounts(windows)
        super().__init__(
            environments,
            desired_data=[query],
            desired_dt=_Step(windows.dt_s),
            history_sec=(windows.history_s, windows.history_s),
            future_sec=(windows.horizon_s, windows.horizon_s),
            agent_interaction_distances=_OneRadius(windows.radius_m),
            only_predict=list(windows.modes),  # type: ignore[arg-type]
            state_format=STATE_FORMAT_STR,
            obs_format=OBSERVED,
            augmentations=list(corrections),  # type: ignore[arg-type]
            max_neighbor_num=windows.neighbors,
            data_dirs=dict(raw_folders or {}),
            cache_location=str(cache),
            require_map_cache=False,
        )

    def _get_data_index(self, num_workers: int, scene_paths: list[Path]) -> list[Any]:
        index = []
        for scene_path in scene_paths:
            with told_as_damage(Path(scene_path), self._remedy(scene_path)):
                entry: tuple[Any, ...] = self._get_data_index_agent(
                    scene_path,
                    incl_robot_future=False,
                    only_types=None,
                    only_predict=self.only_predict,
                    no_types=None,
                    history_sec=self.history_sec,
                    future_sec=self.future_sec,
                    desired_dt=self.desired_dt,
                    ret_scene_info=True,
                )
            scene, path, elements, agents = entry
            modes = {agent.name: int(agent.type) for agent in scene.agents}
            for agent in scene.agents:
                self.counts.add(modes[agent.name], agent.last_timestep - agent.first_timestep + 1)
            if elements:
                index.append((str(path), elements, agents))
                self._modes.append([modes[name] for name, _ in agents])
        self.counts.require_windows(self.desired_data[0])
        return encoded(index)

    def __getitem__(self, idx: int) -> AgentBatchElement:
        """Return trajdata's element of one window."""
        path, agent, row = self._data_index[idx]
        if self._opened is None or self._opened.path != path:
            self._opened = self._open(path)
        _, scene, table = self._opened
        element = AgentBatchElement(
            table,
            idx,
            SceneTimeAgent.from_cache(scene, row, agent, table),  # type: ignore[arg-type]
            history_sec=self.history_sec,
            future_sec=self.future_sec,
            agent_interaction_distances=self.agent_interaction_distances,
            state_format=self.state_format,
            standardize_data=True,
            max_neighbor_num=self.max_neighbor_num,
        )
        element.extras[EXACT_FRAME] = element.agent_from_world_tf
        return element

    def _open(self, path: str) -> _OpenScene:
        with told_as_damage(Path(path), self._remedy(path)):
            scene = EnvCache.load(path)
            scene_utils.enforce_desired_dt(scene, self.desired_dt)
        table = SceneTable(self.cache_path, scene, self._corrections, self._remedy(path))
        table.set_obs_format(self.obs_format)
        return _OpenScene(path, scene, table)

    def _remedy(self, scene_path: str | Path) -> str:
        """How to make the files of a scene anew: our conversion, or what trajdata itself keeps."""
        folder = Path(scene_path).parents[1]
        return self._remedies.get(folder.name, f"Delete {folder} and run again: it is made anew.")

    def locations(self) -> WindowLocation:
        """List every `stride`-th window of each agent, scene by scene."""
        index: Any = self._data_index
        elements, rows, modes = [], [], []
        scenes, agents = list[str](), list[str]()
        for number, offset in enumerate(index._cumulative_lengths[:-1]):
            scene = Path(str(index._scene_paths[number], encoding="utf-8")).parent.name
            starts = index._cumulative_scene_lengths[number][:-1]
            spans = index._agent_times[number]
            listed = zip(index._agent_ids[number], self._modes[number], starts, spans, strict=True)
            for agent, mode, start, (first, last) in listed:
                row = np.arange(first, last + 1, self.windows.stride)
                elements.append(offset + start + row - first)
                rows.append(row)
                modes.append(np.full(len(row), mode))
                scenes += [scene] * len(row)
                agents += [str(agent, encoding="utf-8")] * len(row)
        joined = [np.concatenate(parts) for parts in (elements, rows, modes)]
        recordings = [self._recordings.get(scene, scene) for scene in scenes]
        return WindowLocation(joined[0], scenes, agents, joined[1], joined[2], recordings)
