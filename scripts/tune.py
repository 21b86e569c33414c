"""Tune the cost weights of a controller on whole episodes, along the gradient or without any."""

import json
import logging
from pathlib import Path

from diffstack_mmv.cli import DictConfig, command, instantiate
from dmmv_conventions.checks import require, require_at_least
from dmmv_conventions.configs import config_folder

logger = logging.getLogger(__name__)


def check(config: DictConfig) -> None:
    """Refuse test cases, and a world or a controller that cannot be built."""
    require(config.phase != "test", "phase", "be train or val", config.phase)
    require_at_least("cases", config.cases, 1)
    for part in (config.scenario, config.world, config.controller, config.loss, config.tuner):
        instantiate(part)


@command(config_folder(), "tune", check)
def main(config: DictConfig) -> None:
    """Tune; write every round, and the best weights as settings of `navigate`."""
    import torch

    from diffstack_mmv.simulation.tuning import best

    torch.manual_seed(config.seed)
    scenario, world = instantiate(config.scenario), instantiate(config.world)
    controller, loss, out = (
        instantiate(config.controller),
        instantiate(config.loss),
        Path(config.out),
    )
    scene = scenario.cases(config.phase, range(config.first_case, config.first_case + config.cases))
    rounds = []
    tuner = instantiate(config.tuner)
    for each in tuner(controller.planner.cost, lambda: loss(world, scene, controller).mean()):
        rounds.append(each)
        logger.info("Round %d: loss %.4f, best %.4f, %.0f s.",
                    len(rounds), each.loss, best(rounds).loss, each.seconds)  # fmt: skip
        told = [row._asdict() for row in rounds]
        (out / "rounds.json").write_text(json.dumps(told, indent=1), encoding="utf-8")
    chosen = best(rounds)
    lines = [f"cost.weights.{name}={weight:.6g}" for name, weight in chosen.weights.items()]
    steps = config.controller.planner.solver.max_iterations
    lines.append(f"controller.planner.solver.max_iterations={steps}")
    (out / "settings.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    logger.info("Drive it: dmmv-navigate ... $(cat %s)", out / "settings.txt")


if __name__ == "__main__":
    main()
