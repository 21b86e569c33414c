"""Opening a converted cache as a trajdata `UnifiedDataset`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_converters.errors import CacheError, require
from dmmv_conventions.cache import SPLITS, read_state

if TYPE_CHECKING:
    from trajdata import UnifiedDataset


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
    from dmmv_conventions.opening import CachedEnvironment, CachedUnifiedDataset

    for name, wanted in splits.items():
        known = bool(wanted) and set(wanted) <= set(SPLITS)
        require(known, "splits", f"be of {SPLITS}", wanted, f"'{name}'", "Give a list of splits.")
    desired = [f"{name}-{split}" for name, wanted in splits.items() for split in wanted]
    environments = [
        CachedEnvironment(cache, read_state(cache, name, CacheError)) for name in splits
    ]
    return CachedUnifiedDataset(
        environments, desired_data=desired, cache_location=str(cache), **options
    )
