"""How trajdata 1.4.0 opens a converted cache: without raw recordings, a fork or a patch.

trajdata knows its data sets by name only. So an environment lists its scenes from the state of the
cache, and a subclass of `UnifiedDataset` puts environments in place where the base class first
looks for them.
"""

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from trajdata import UnifiedDataset
from trajdata.caching.env_cache import EnvCache
from trajdata.data_structures.environment import EnvMetadata
from trajdata.data_structures.scene_metadata import Scene
from trajdata.data_structures.scene_tag import SceneTag
from trajdata.dataset_specific.raw_dataset import RawDataset

from dmmv_conventions.cache import SPLITS, conversion_of, require_own


def environment(name: str, dt_s: float, scene_splits: Mapping[str, str]) -> EnvMetadata:
    """Trajdata's description of a data set with the tags `name` x train, val, test; dt_s in s."""
    parts: list[Any] = [SPLITS]
    metadata = EnvMetadata(name, name, dt_s, parts, dict(scene_splits))
    # trajdata makes the folder absolute, which has no place in a cache that may be moved
    metadata.data_dir = Path(name)
    return metadata


class CachedEnvironment(RawDataset):
    """A converted data set: lists its scenes, holds no raw recordings."""

    def __init__(self, cache: Path, state: Mapping[str, Any]) -> None:
        """Describe the environment that `state`, the content of its `cache.json`, tells of.

        Raises:
            ValueError: Another user wrote it: it holds pickles, which run code when they are read.
        """
        require_own(cache / state["dataset"], conversion_of(state["dataset"], cache))
        self._state = state
        super().__init__(state["dataset"], str(cache), parallelizable=False, has_maps=False)

    def compute_metadata(self, env_name: str, data_dir: str) -> EnvMetadata:
        """The environment as it was written, with the step in s and the split of each scene."""
        splits = {scene["name"]: scene["split"] for scene in self._state["scenes"]}
        return environment(env_name, self._state["dt_s"], splits)

    def _get_matching_scenes_from_cache(
        self, scene_tag: SceneTag, scene_desc_contains: list[str] | None, env_cache: EnvCache
    ) -> list[Scene]:
        place = self._state["location"]
        return [
            Scene(self.metadata, scene["name"], place, scene["split"], scene["steps"], index, None)
            for index, scene in enumerate(self._state["scenes"])
            if scene["split"] in scene_tag and scene_desc_contains is None
        ]


def encoded(index: Iterable[tuple[Any, ...]]) -> list[Any]:
    """An index of trajdata with its paths and agents as bytes.

    trajdata keeps both as bytes of ASCII and reads them as UTF-8: given as text, a letter outside
    of ASCII anywhere in the path of a cache would end in a traceback.
    """
    return [
        (os.fsencode(path), count, [_encoded_agent(part) for part in elements])
        for path, count, elements in index
    ]


def _encoded_agent(element: Any) -> Any:
    """An entry of an index by agents; those of an index by scenes are plain numbers."""
    return (element[0].encode(), element[1]) if isinstance(element, tuple) else element


class CachedUnifiedDataset(UnifiedDataset):
    """`UnifiedDataset` over converted caches."""

    def __init__(self, environments: Sequence[RawDataset], **options: Any) -> None:
        """Open `environments`.

        Args:
            environments: Converted data sets; none if trajdata itself knows the data sets.
            options: Those of `UnifiedDataset`; without `data_dirs` it looks for no recordings.
        """
        self._converted = list(environments)
        super().__init__(**{"data_dirs": {}, **options})
        self._scene_index = [Path(os.fsdecode(path)) for path in self._scene_index]

    def _get_data_index(self, num_workers: int, scene_paths: list[Path]) -> list[Any]:
        return encoded(super()._get_data_index(num_workers, scene_paths))

    def _get_matching_scene_tags(self, queries: list[str]) -> list[SceneTag]:
        if self._converted:
            self.envs = self._converted
            self.envs_dict = {environment.name: environment for environment in self._converted}
        return super()._get_matching_scene_tags(queries)
