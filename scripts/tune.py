"""Tune the cost weights of a controller on whole episodes, along the gradient or without any."""

import json
import logging
from pathlib import Path
from typing import Any

from diffstack_mmv.commands.cli import DictConfig, OmegaConf, command, instantiate
from diffstack_mmv.commands.run_checks import require_same_run
from dmmv_conventions.checks import require, require_at_least
from dmmv_conventions.configs import config_folder

logger = logging.getLogger(__name__)


def check(config: DictConfig) -> None:
    """Refuse test cases, and a world or a controller that cannot be built."""
    require(config.phase != "test", "phase", "be train or val", config.phase)
    require_at_least("cases", config.cases, 1)
    for part in (config.scenario, config.world, config.loss, config.tuner):
        instantiate(part)
    learned = instantiate(config.controller).planner.cost.learned
    require(learned, "cost.frozen", "leave a weight to tune", list(config.cost.frozen))


def admit(config: DictConfig) -> None:
    """Refuse a folder with what another tuning has found."""
    content: Any = OmegaConf.to_container(config)
    require_same_run(Path(config.out), "tune", content)


@command(config_folder(), "tune", check, admit)
def main(config: DictConfig) -> None:
    """Tune; write after every round all of them, and the best weights as settings of `navigate`."""
    import torch

    from diffstack_mmv.reporting import write_text
    from diffstack_mmv.simulation.tuning import Round, best

    torch.manual_seed(config.seed)
    scenario, world = instantiate(config.scenario), instantiate(config.world)
    controller, loss, out = (
        instantiate(config.controller),
        instantiate(config.loss),
        Path(config.out),
    )
    scene = scenario.cases(config.phase, range(config.first_case, config.first_case + config.cases))
    rounds: list[Round] = []
    tuner = instantiate(config.tuner)
    for each in tuner(controller.planner.cost, lambda: loss(world, scene, controller).mean()):
        rounds.append(each)
        logger.info("Round %d: loss %.4f, best %.4f, %.0f s.",
                    len(rounds), each.loss, best(rounds).loss, each.seconds)  # fmt: skip
        told = [row._asdict() for row in rounds]
        write_text(out / "rounds.json", json.dumps(told, indent=1))
        lines = [f"cost.weights.{name}={w:.6g}" for name, w in best(rounds).weights.items()]
        planner = config.controller.planner
        lines.append(f"controller.planner.solver.max_iterations={planner.solver.max_iterations}")
        lines.append(f"controller.planner.coordinates._target_={planner.coordinates._target_}")
        write_text(out / "settings.txt", "\n".join(lines) + "\n")
    logger.info("Drive it: dmmv-navigate ... $(cat %s)", out / "settings.txt")


if __name__ == "__main__":
    main()
