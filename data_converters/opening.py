"""Opening a converted cache as a trajdata `UnifiedDataset`, without raw data or a patch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from trajdata import UnifiedDataset
from trajdata.caching.env_cache import EnvCache
from trajdata.data_structures.environment import EnvMetadata
from trajdata.data_structures.scene_metadata import Scene
from trajdata.data_structures.scene_tag import SceneTag
from trajdata.dataset_specific.raw_dataset import RawDataset

from data_converters.cache import environment, read_state
from data_converters.errors import refuse
from data_converters.recordings import SPLITS


class CachedDataset(RawDataset):
    """A converted data set for trajdata: lists its scenes from the cache, holds no raw data."""

    def __init__(self, cache: Path, name: str) -> None:
        """Read the state of environment `name` in `cache`.

        Raises:
            CacheError: If the environment is absent, unfinished or of another version.
        """
        self._state = read_state(cache, name)
        super().__init__(name, str(cache), parallelizable=False, has_maps=False)

    def compute_metadata(self, env_name: str, data_dir: str) -> EnvMetadata:
        """The environment as it was written, with dt in s and the split of each scene."""
        splits = {scene["name"]: scene["split"] for scene in self._state["scenes"]}
        return environment(env_name, self._state["dt_s"], splits)

    def _get_matching_scenes_from_cache(
        self, scene_tag: SceneTag, scene_desc_contains: list[str] | None, env_cache: EnvCache
    ) -> list[Scene]:
        return [
            Scene(self.metadata, name, location, split, steps, index, None)
            for name, location, split, steps, index in env_cache.load_env_scenes_list(self.name)
            if split in scene_tag and scene_desc_contains is None
        ]


class CachedUnifiedDataset(UnifiedDataset):
    """`UnifiedDataset` over converted caches.

    The constructor of the base class gets no data directories; the environments are put in place
    where it first looks for them.
    """

    def __init__(self, environments: Sequence[RawDataset], **options: Any) -> None:
        """Open `environments`; `options` are those of `UnifiedDataset` without `data_dirs`."""
        self._converted = list(environments)
        super().__init__(data_dirs={}, **options)

    def _get_matching_scene_tags(self, queries: list[str]) -> list[SceneTag]:
        self.envs = self._converted
        self.envs_dict = {environment.name: environment for environment in self._converted}
        return super()._get_matching_scene_tags(queries)


def open_cache(cache: Path, splits: Mapping[str, Sequence[str]], **options: Any) -> UnifiedDataset:
    """Open converted data sets for iteration.

    Args:
        cache: Folder of the cache.
        splits: Data sets and their splits, as {"thab_vru": ["train", "val"]}.
        options: Passed to `UnifiedDataset`: history_sec, future_sec (s), only_predict, ...

    Returns:
        The data set; a `DataLoader` may iterate it with forked workers.

    Raises:
        ConversionError: If a split is none of train, val, test.
        CacheError: If a data set is absent, unfinished or of another version.
    """
    for name, wanted in splits.items():
        unknown = set(wanted) - set(SPLITS)
        wrong, remedy = bool(unknown) or not wanted, "Give a list of splits."
        refuse(wrong, "splits", f"be of {SPLITS}", wanted, f"'{name}'", remedy)
    desired = [f"{name}-{split}" for name, wanted in splits.items() for split in wanted]
    environments = [CachedDataset(cache, name) for name in splits]
    return CachedUnifiedDataset(
        environments, desired_data=desired, cache_location=str(cache), **options
    )
