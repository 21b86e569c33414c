"""Train a driving policy by reinforcement, in many crowds side by side."""

import json
import logging
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from diffstack_mmv.commands.cli import DictConfig, OmegaConf, command, instantiate
from diffstack_mmv.commands.run_checks import require_same_run
from dmmv_conventions.checks import require_at_least
from dmmv_conventions.configs import config_folder

logger = logging.getLogger(__name__)


def check(config: DictConfig) -> None:
    """Refuse a world that cannot be built, before anything is trained."""
    require_at_least("envs", config.envs, 1)
    for part in (config.scenario, config.world, config.view):
        instantiate(part)
    import_module("diffstack_mmv.simulation.reinforcement")  # tells the extra that it needs


def admit(config: DictConfig) -> None:
    """Refuse a folder with the policy of another training."""
    content: Any = OmegaConf.to_container(config)
    require_same_run(Path(config.out), "train_policy", content)


@command(config_folder(), "train_policy", check, admit)
def main(config: DictConfig) -> None:
    """Train for a given processor time; write the policy and the curve of its outcomes."""
    import torch

    from diffstack_mmv.reporting import write_text
    from diffstack_mmv.simulation import CrowdNavVectorEnv

    out = Path(config.out)
    if (out / "curve.json").is_file():
        logger.info("The policy is there: %s. Delete the folder to train it again.", out)
        return
    torch.manual_seed(config.seed)
    world = instantiate(config.world)
    rewards = replace(world.verdict.rewards, collision=config.collision_reward)
    world = replace(world, verdict=replace(world.verdict, rewards=rewards))
    scenario, view = instantiate(config.scenario), instantiate(config.view)
    env = CrowdNavVectorEnv(world, scenario, config.envs, view, config.progress_reward)
    curve = instantiate(config.training)(env, out / "policy.zip")
    write_text(out / "curve.json", json.dumps(curve, indent=1))
    ends = ", ".join(f"{label} {count}" for label, count in curve[-1]["outcomes"].items())
    logger.info(
        "%d steps; episodes that ended in the last update: %s. Drive it: dmmv-navigate "
        "controller=ppo policy=%s", curve[-1]["steps"], ends, out / "policy.zip",
    )  # fmt: skip


if __name__ == "__main__":
    main()
