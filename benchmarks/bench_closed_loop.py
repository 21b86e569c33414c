"""Time of one decision of the closed-loop controller per episode, one alone and fifty at once, on one core.

Processor time of the one thread, so that a busy machine does not count. The settings are those of `scripts/navigate.py`; a
drive before builds the libraries. Run: OMP_NUM_THREADS=1 python benchmarks/bench_closed_loop.py
"""

import time
from pathlib import Path

import numpy as np
import torch
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import OmegaConf

import diffstack_mmv.commands.cli  # noqa: F401  registers the resolvers
from diffstack_mmv.simulation import ExactVerdict, OrcaCrowd, World, drive
from diffstack_mmv.types import SolverStatus

CONFIGS = str(Path(__file__).resolve().parents[1] / "configs")
CASES = 15
BEFORE = range(100, 101)


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
        self.controller, self.seconds, self.statuses = controller, [], []

    def init(self, observation):
        return self.controller.init(observation)

    def act(self, state, observation):
        start = time.process_time()
        decided = self.controller.act(state, observation)
        running = max(int(observation.running.sum()), 1)
        self.seconds.append((time.process_time() - start) / running)
        self.statuses.append(decided.state.decisions[-1].status.flatten())
        return decided


def measure(dynamics, episodes, repeats):
    config = composed(dynamics)
    world = World(instantiate(config.robot), OrcaCrowd(), ExactVerdict(10.0))
    scenario, seconds, first, statuses = instantiate(config.scenario), [], [], []
    for repeat in range(-1, repeats):
        timed = Timed(instantiate(config.controller))
        numbers = range(repeat * episodes, (repeat + 1) * episodes) if repeat >= 0 else BEFORE
        drive(world, scenario.cases("train", numbers), timed)
        if repeat >= 0:
            seconds += timed.seconds
            first.append(timed.seconds[0])
            statuses += timed.statuses
    middle, high, highest = np.quantile(1e3 * np.array(seconds), (0.5, 0.9, 0.99))
    solved = (torch.cat(statuses) == SolverStatus.CONVERGED).float().mean()
    print(
        f"| {dynamics} | {episodes} | {middle:.1f} | {high:.1f} | {highest:.1f} | {1e3 * np.median(first):.1f} "
        f"| {float(solved):.0%} | {len(seconds)} |",
        flush=True,
    )


if __name__ == "__main__":
    torch.set_num_threads(1)
    print(
        "| model | episodes | median, ms | 90 % | 99 % | first | converged | decisions |\n|---|---|---|---|---|---|---|---|"
    )
    for name in ("kbm", "gm3"):
        for count, times in ((1, CASES), (50, 1)):
            measure(name, count, times)
