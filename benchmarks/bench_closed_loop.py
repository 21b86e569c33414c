"""Time of one decision of the closed-loop controller per episode, batched and single, on one core.

Run: OMP_NUM_THREADS=1 python benchmarks/bench_closed_loop.py
"""

import time
from pathlib import Path

import numpy as np
import torch
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import OmegaConf

import diffstack_mmv.cli  # noqa: F401  registers the resolvers
from diffstack_mmv.simulation import DiscFootprint, ExactVerdict, OrcaCrowd, World, drive
from diffstack_mmv.simulation.benchmark import Timed

CONFIGS = str(Path(__file__).resolve().parents[1] / "configs")


def composed(dynamics):
    with initialize_config_dir(CONFIGS, version_base="1.3"):
        config = compose("navigate", [f"dynamics={dynamics}"], return_hydra_config=True)
        HydraConfig.instance().set_config(config)
        OmegaConf.set_struct(config, False)
        config.pop("hydra")
    OmegaConf.resolve(config)
    return config


def measure(dynamics, episodes):
    config = composed(dynamics)
    world = World(instantiate(config.robot), OrcaCrowd(), ExactVerdict(DiscFootprint(), 10.0))
    timed = Timed(instantiate(config.controller))
    start = time.perf_counter()
    drive(world, instantiate(config.scenario).cases("train", range(episodes)), timed)
    wall = time.perf_counter() - start
    middle, high = np.quantile(1e3 * np.array(timed.seconds), (0.5, 0.99))
    print(f"{dynamics:4s} {episodes:4d} episodes: {middle:8.1f} ms, p99 {high:8.1f} ms per decision"
          f" and episode; {wall:6.1f} s in all")  # fmt: skip


if __name__ == "__main__":
    torch.set_num_threads(1)
    for name in ("kbm", "gm3"):
        for count in (1, 50):
            measure(name, count)
