"""Time of one decision of the closed-loop controller per episode, batched and single, on one core.

Processor time of the one thread, so that a busy machine does not count. The first decision of each
drive is left out. Run: OMP_NUM_THREADS=1 python benchmarks/bench_closed_loop.py
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
from diffstack_mmv.simulation import ExactVerdict, OrcaCrowd, World, drive

CONFIGS = str(Path(__file__).resolve().parents[1] / "configs")


def composed(dynamics):
    with initialize_config_dir(CONFIGS, version_base="1.3"):
        config = compose("navigate", [f"dynamics={dynamics}"], return_hydra_config=True)
        HydraConfig.instance().set_config(config)
        OmegaConf.set_struct(config, False)
        config.pop("hydra")
    OmegaConf.resolve(config)
    return config


class Timed:
    """A controller under a stop-watch of processor time, per running episode."""

    def __init__(self, controller):
        self.controller, self.seconds = controller, []

    def init(self, observation):
        return self.controller.init(observation)

    def act(self, state, observation):
        start = time.process_time()
        decided = self.controller.act(state, observation)
        running = max(int(observation.running.sum()), 1)
        self.seconds.append((time.process_time() - start) / running)
        return decided


def measure(dynamics, episodes, repeats):
    config = composed(dynamics)
    world = World(instantiate(config.robot), OrcaCrowd(), ExactVerdict(10.0))
    scenario, seconds = instantiate(config.scenario), []
    for repeat in range(repeats):
        timed = Timed(instantiate(config.controller))
        numbers = range(repeat * episodes, (repeat + 1) * episodes)
        drive(world, scenario.cases("train", numbers), timed)
        seconds += timed.seconds[1:]
    middle, high = np.quantile(1e3 * np.array(seconds), (0.5, 0.99))
    print(f"{dynamics:4s} {episodes:4d} episodes: {middle:8.1f} ms, p99 {high:8.1f} ms per decision"
          f" and episode, {len(seconds)} decisions", flush=True)  # fmt: skip


if __name__ == "__main__":
    torch.set_num_threads(1)
    for name in ("kbm", "gm3"):
        for count, times in ((1, 6), (50, 1)):
            measure(name, count, times)
