"""A tiny cache in the layout of our converters, written with trajdata's own classes."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from trajdata.caching.df_cache import DataFrameCache
from trajdata.caching.env_cache import EnvCache
from trajdata.data_structures.agent import AgentMetadata, FixedExtent
from trajdata.data_structures.environment import EnvMetadata
from trajdata.data_structures.scene_metadata import Scene

from diffstack_mmv.data import ConvertedCache, ExportSettings, WindowSettings
from diffstack_mmv.types import Mode

DT_S = 0.1


@dataclass(frozen=True)
class ToyAgent:
    """An agent on a circle (or a straight line where the yaw rate is zero), seen for some rows."""

    name: str
    mode: Mode
    rows: int
    first: int = 0
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)  # x, y in m and heading in rad at row 0
    speed: float = 3.0
    yaw_rate: float = 0.0

    def table(self) -> pd.DataFrame:
        time = (self.first + np.arange(self.rows)) * DT_S
        x0, y0, h0 = self.start
        heading = h0 + self.yaw_rate * time
        if self.yaw_rate:
            radius = self.speed / self.yaw_rate
            x = x0 + radius * (np.sin(heading) - np.sin(h0))
            y = y0 - radius * (np.cos(heading) - np.cos(h0))
        else:
            x, y = x0 + self.speed * time * np.cos(h0), y0 + self.speed * time * np.sin(h0)
        columns = {"x": x, "y": y, "z": 0.0 * x}
        columns |= {"vx": self.speed * np.cos(heading), "vy": self.speed * np.sin(heading)}
        columns |= {"ax": 0.0 * x, "ay": 0.0 * x, "heading": heading}
        steps = self.first + np.arange(self.rows)
        beside = {"agent_id": self.name, "scene_ts": steps, "interpolated": False}
        return pd.DataFrame(columns).assign(**beside)


def write_cache(folder: Path, scenes: dict[str, tuple[str, list[ToyAgent]]], name: str = "toy"):
    """Write scenes, given as {name: (split, agents)}."""
    splits = {scene: split for scene, (split, _) in scenes.items()}
    metadata = EnvMetadata(name, str(folder), DT_S, [("train", "val", "test")], splits)
    listed = []
    for scene_name, (split, agents) in scenes.items():
        steps = max(agent.first + agent.rows for agent in agents)
        scene = Scene(metadata, scene_name, "here", split, steps, 0, None)
        known = [
            AgentMetadata(a.name, a.mode, a.first, a.first + a.rows - 1, FixedExtent(1.8, 0.6, 1.7))
            for a in agents
        ]
        presence = [
            [agent for agent in known if agent.first_timestep <= step <= agent.last_timestep]
            for step in range(steps)
        ]
        scene.update_agent_info(known, presence)
        rows = pd.concat([agent.table() for agent in agents], ignore_index=True)
        DataFrameCache.save_agent_data(rows.set_index(["agent_id", "scene_ts"]), folder, scene)
        EnvCache(folder).save_scene(scene)
        listed.append({"name": scene_name, "split": split, "steps": steps})
    EnvCache(folder).save_env_scenes_list(name, listed)
    state = {"format_version": 1, "complete": True, "dataset": name, "dt_s": DT_S}
    state |= {"location": "here", "scenes": listed}
    (folder / name / "cache.json").write_text(json.dumps(state))


def crowd() -> list[ToyAgent]:
    """A cyclist, a scooter rider, and neighbors that come, go and stand."""
    return [
        ToyAgent("cyclist", Mode.BICYCLE, 90, start=(100.0, -40.0, 2.5), yaw_rate=0.4),
        ToyAgent("rider", Mode.SCOOTER, 85, start=(105.0, -40.0, -1.0), speed=4.0),
        ToyAgent("walker", Mode.PEDESTRIAN, 30, first=16, start=(98.0, -42.0, 0.3), speed=1.2),
        ToyAgent("waiting", Mode.WHEELCHAIR, 90, start=(102.0, -38.0, 1.0), speed=0.0),
        ToyAgent("far", Mode.CAR, 90, start=(160.0, -40.0, 0.0), speed=0.0),
    ]


@pytest.fixture(scope="session")
def cache(tmp_path_factory) -> Path:
    """Five training scenes, one validation and one test scene."""
    folder = tmp_path_factory.mktemp("cache")
    alone = [ToyAgent("alone", Mode.BICYCLE, 80, start=(0.0, 0.0, 3.0), speed=2.0)]
    scenes = {f"scene_{number}": ("train", crowd()) for number in range(4)}
    scenes["scene_4"] = ("train", alone)
    scenes["scene_5"] = ("val", crowd())
    scenes["scene_6"] = ("test", [*crowd(), *alone])
    write_cache(folder, scenes)
    return folder


@pytest.fixture
def source(cache) -> ConvertedCache:
    return ConvertedCache("toy", str(cache))


@pytest.fixture
def windows() -> WindowSettings:
    return WindowSettings(ego_modes=("bicycle", "scooter"))


@pytest.fixture
def exporting(tmp_path) -> ExportSettings:
    return ExportSettings(str(tmp_path / "exports"), progress=False)
