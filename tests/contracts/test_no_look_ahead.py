"""Whatever data set is converted: no input of a window changes when its future is replaced."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

import diffstack_mmv.commands.cli  # noqa: F401  registers the resolvers
from data_converters import ConversionSettings, ResampleSettings, convert
from diffstack_mmv.data import DirectWindows
from tests.data_converters.synthetic import WRITERS

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
DATA_SETS = sorted({path.stem for path in (CONFIGS / "data").glob("*.yaml")})
CONVERTED = [name for name in DATA_SETS if name not in ("converted", "trajdata")]

CHANGE_S = 6.0
MODES = "[bicycle,scooter,pedestrian,cart,car,skateboard]"
CONVERSION = {"eth_ucy": ["dt_s=0.4", "min_duration_s=0.4"]}
WINDOWS = {"eth_ucy": ["dt_s=0.4", "horizon_s=1.2"]}


def conversion(name, root, cache, *overrides):
    """The data set of a configuration, converted; its data module and its step."""
    known = [f"data={name}", f"data.root={root}", f"data.cache={cache}"]
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        given = [*known, f"out={cache}", *CONVERSION.get(name, []), *overrides]
        config = compose("convert", given)
        cut = [f"modes={MODES}", "history_s=2.0", "horizon_s=1.0", "data.stride=1"]
        windows = compose("evaluate", [*known, "checkpoint=none", *cut, *WINDOWS.get(name, [])])
    resample = ResampleSettings(
        dt_s=config.dt_s,
        min_duration_s=config.min_duration_s,
        smoother=instantiate(config.smoother),
        backfill_heading=config.backfill_heading,
    )
    dataset = instantiate(config.data.recordings)
    convert(ConversionSettings(dataset, cache, resample, strict=True, progress=False))
    return instantiate(windows.data.module)


def inputs(module):
    """By scene, agent and row all inputs of the windows whose present is before the change."""
    found = {}
    for split in sorted({scene["split"] for scene in module.source.scenes()}):
        windows = DirectWindows(module.source.open(split, module.windows), module.source.name)
        table = windows.samples
        early = table.index[table["row"] * module.windows.dt_s <= CHANGE_S + 1e-6]
        # the pieces of a two-wheeler's ride have clocks of their own; only the first starts early
        early = [i for i in early if not table["scene"][i].endswith(("cycle_1", "cycle_2"))][::8]
        if not early:
            continue
        batch = windows[early]
        for number, index in enumerate(early):
            key = tuple(table.loc[index, ["scene", "agent", "row"]])
            found[key] = [
                np.concatenate([np.ravel(part[number]) for part in leaves(tracks)])
                for tracks in (batch.ego_past, batch.neighbors_past)
            ]
    return found


def leaves(tracks):
    """All tensors of a nest of named tuples."""
    if hasattr(tracks, "_fields"):
        return [leaf for part in tracks for leaf in leaves(part)]
    return [] if tracks is None else [tracks.double().numpy()]


def beside(cache, stem):
    """What a table says about the time before the change, over all scenes."""
    tables = [pd.read_parquet(path) for path in sorted(cache.glob(f"*/*/{stem}.parquet"))]
    return [table[table["time_s"] <= CHANGE_S] for table in tables]


def difference(first, second):
    return max(
        (np.abs(a - b).max(initial=0.0) if a.shape == b.shape else np.inf)
        for key in first
        for a, b in zip(first[key], second[key], strict=True)
    )


def both(name, tmp_path, *overrides):
    made = []
    for title, change_s in (("as_it_was", None), ("another_future", CHANGE_S)):
        root, cache = tmp_path / title / "raw", tmp_path / title / "cache"
        WRITERS[name](root, change_s)
        made.append(inputs(conversion(name, root, cache, *overrides)))
    return made


@pytest.mark.parametrize("name", CONVERTED)
def test_no_input_changes_when_the_future_is_replaced(name, tmp_path):
    first, second = both(name, tmp_path)
    assert len(first) > 0
    assert first.keys() == second.keys()
    assert difference(first, second) < 1e-6
    caches = tmp_path / "as_it_was" / "cache", tmp_path / "another_future" / "cache"
    for stem in ("controls", "sensors"):
        for one, other in zip(*(beside(cache, stem) for cache in caches), strict=True):
            pd.testing.assert_frame_equal(one, other)


def test_samples_as_they_are_change_with_no_future(tmp_path):
    first, second = both("eth_ucy", tmp_path, "smoother=none")
    assert difference(first, second) < 1e-6


def test_the_zero_phase_smoother_is_found_out(tmp_path):
    first, second = both("csv", tmp_path, "smoother=zero_phase")
    assert difference(first, second) > 1e-2
