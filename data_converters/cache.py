"""Writing of a cache: trajdata's own files per scene, and tables beside them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from data_converters.errors import require
from data_converters.recordings import RawScene
from data_converters.tracks import AgentRows
from dmmv_conventions.cache import side_table
from dmmv_conventions.disk import replacing

if TYPE_CHECKING:
    from trajdata.data_structures.agent import AgentMetadata
    from trajdata.data_structures.environment import EnvMetadata
    from trajdata.data_structures.scene_metadata import Scene

SCENE_REPORT_FILE = "conversion.json"


def write_scene(
    base: Path,
    metadata: EnvMetadata,
    name: str,
    location: str,
    agents: Sequence[AgentRows],
    raw: RawScene,
) -> Scene:
    """Write one scene under `base`/environment/scene as trajdata 1.4.0 stores it.

    Args:
        base: Folder that takes the place of the cache.
        metadata: The environment, with the split of this scene.
        name: Name of the scene.
        location: Name of the place.
        agents: At least one stretch; rows every dt_s.
        raw: Gives side tables and signals.

    Returns:
        trajdata's record of the scene.

    Raises:
        ConversionError: If two agents have one name.
    """
    names = Counter(agent.name for agent in agents)
    repeated = [each for each, times in names.items() if times > 1]
    remedy = "Name its agents apart."
    require(not repeated, "agents", "have a name each", repeated, f"scene {name}", remedy)
    # trajdata takes seconds to import: not before something is written
    from trajdata.caching.df_cache import DataFrameCache
    from trajdata.caching.env_cache import EnvCache
    from trajdata.data_structures.scene_metadata import Scene

    steps = max(agent.first_step + len(agent.rows) for agent in agents)
    split = metadata.scene_split_map[name]
    scene = Scene(metadata, name, location, split, steps, 0, None)
    listed = [_agent_metadata(agent) for agent in agents]
    presence: list[list[AgentMetadata]] = [[] for _ in range(steps)]
    for agent in listed:
        for step in range(agent.first_timestep, agent.last_timestep + 1):
            presence[step].append(agent)
    scene.update_agent_info(listed, presence)
    DataFrameCache.save_agent_data(_agent_table(agents), base, scene)
    if raw.signals is not None:
        DataFrameCache.save_traffic_light_data(raw.signals, base, scene)
    for stem, table in raw.side_tables.items():
        table.to_parquet(side_table(base / metadata.name / name, stem), index=False)
    EnvCache(base).save_scene(scene)
    return scene


def _agent_metadata(agent: AgentRows) -> AgentMetadata:
    from trajdata.data_structures.agent import AgentMetadata

    return AgentMetadata(
        name=agent.name,
        agent_type=agent.mode,  # type: ignore[arg-type]
        first_timestep=agent.first_step,
        last_timestep=agent.first_step + len(agent.rows) - 1,
        extent=agent.extent,
    )


def _agent_table(agents: Sequence[AgentRows]) -> pd.DataFrame:
    parts = []
    for agent in agents:
        steps = range(agent.first_step, agent.first_step + len(agent.rows))
        parts.append(agent.rows.assign(agent_id=agent.name, scene_ts=steps))
    return pd.concat(parts, ignore_index=True).set_index(["agent_id", "scene_ts"])


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write `content` so that a reader sees the old file or the whole new one, never a part."""
    with replacing(path) as unfinished:
        unfinished.write_text(json.dumps(content, indent=1, default=str) + "\n", encoding="utf-8")
