"""The scenes of a converted cache as its files hold them."""

from pathlib import Path

import pandas as pd
from trajdata.caching.env_cache import EnvCache
from trajdata.data_structures.scene_metadata import Scene

from diffstack_mmv.checks import message
from diffstack_mmv.data.damage import only_file, told_as_damage
from diffstack_mmv.data.sources import ConvertedCache, WindowSource
from dmmv_conventions.cache import conversion_of, require_own


def converted(source: WindowSource) -> ConvertedCache:
    """The source as the cache that it has to be.

    Raises:
        ValueError: It is none, or no finished conversion of ours.
    """
    if not isinstance(source, ConvertedCache):
        wanted = "be a cache written by scripts/convert.py"
        raise ValueError(message("data", wanted, type(source).__name__, "", "Convert it first."))
    folder = Path(source.folder)
    require_own(folder / source.name, conversion_of(source.name, folder))
    return source


def scene_folder(cache: ConvertedCache, scene: str) -> Path:
    """Where a scene lies."""
    return Path(cache.folder) / cache.name / scene


def scene_of(cache: ConvertedCache, name: str) -> Scene:
    """Who is in a scene, and when.

    Raises:
        ValueError: Its file is missing or damaged.
    """
    path = only_file(scene_folder(cache, name), "scene_metadata_dt*.dill")
    with told_as_damage(path, conversion_of(cache.name, Path(cache.folder))):
        return EnvCache.load(path)


def agent_rows(cache: ConvertedCache, name: str) -> pd.DataFrame:
    """All rows of a scene, in the order of time.

    Raises:
        ValueError: Their file is missing or damaged.
    """
    path = only_file(scene_folder(cache, name), "agent_data_dt*.feather")
    with told_as_damage(path, conversion_of(cache.name, Path(cache.folder))):
        return pd.read_feather(path).sort_values("scene_ts")


def side_rows(cache: ConvertedCache, path: Path) -> pd.DataFrame:
    """A table that stands beside a scene.

    Raises:
        ValueError: It is damaged.
    """
    with told_as_damage(path, conversion_of(cache.name, Path(cache.folder))):
        return pd.read_parquet(path)
