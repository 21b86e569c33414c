"""Drive a vehicle through a crowd, case by case, beside its baselines."""

import logging
from functools import partial
from pathlib import Path

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from diffstack_mmv.checks import require_at_least, require_one_of
from diffstack_mmv.cli import command
from diffstack_mmv.metrics import CLOSED_LOOP
from diffstack_mmv.plotting import save_stories
from diffstack_mmv.reporting import paired_cases, paired_with_run, write_closed_loop
from diffstack_mmv.simulation import (
    VERDICTS,
    Chunk,
    DiscFootprint,
    HolonomicRobot,
    Method,
    World,
    require_stoppable,
    run,
    summarise,
)
from diffstack_mmv.vehicles import config_folder

logger = logging.getLogger(__name__)


@command(config_folder(), "navigate")
def main(config: DictConfig) -> None:
    """Run the benchmark of the controller and of its baselines; write tables, plots, animations."""
    torch.manual_seed(config.seed)
    require_at_least("cases", config.cases, 1)
    require_one_of("verdict", config.verdict, tuple(VERDICTS))
    scenario = instantiate(config.scenario)
    require_stoppable(instantiate(config.actual), 2 * scenario.circle_radius_m)
    numbers = range(config.first_case, config.first_case + config.cases)
    out = Path(config.out)

    def driven(name: str, controller: DictConfig) -> list[Chunk]:
        method = _method(name, controller, config)
        folder = out / "episodes" / name
        return list(run(method, scenario, numbers, folder, config.chunk, config.phase))

    baselines = {
        name: driven(name, each) for name, each in (config.get("baselines") or {}).items() if each
    }
    chunks = driven(config.names.controller, config.controller)
    header = {
        "vehicle": config.vehicle.name,
        "dynamics": config.names.dynamics,
        "scenario": config.names.scenario,
        "controller": config.names.controller,
        "limit_s": config.limit_s,
        "dt_s": config.dt_s,
        "verdict": config.verdict,
        "humans": config.scenario.humans,
        "robot_visible": config.robot_visible,
        "phase": config.phase,
        "first_case": config.first_case,
        "seed": config.seed,
        "limits": OmegaConf.to_container(config.limits),
        "believed_dynamics": config.believed.dynamics,
    }
    rows = {name: summarise(each) for name, each in baselines.items()}
    published = [dict(each) for each in config.published or ()]
    result = header | summarise(chunks)
    pairs = [{"other": name} | paired_cases(result["cases"], rows[name]["cases"]) for name in rows]
    pairs += [paired_with_run(result, Path(folder)) for folder in config.against]
    write_closed_loop(out, result, rows, CLOSED_LOOP, published, pairs)
    records = [chunk.record for chunk in chunks]
    goal_m = (0.0, scenario.circle_radius_m)
    radius_m = scenario.human_radius_m
    save_stories(out, numbers, records, radius_m, config.animate, goal_m, config.show)
    logger.info("Report: %s", out / "closed_loop.md")


def _method(name: str, controller: DictConfig, config: DictConfig) -> Method:
    """A row of the table: massless robots for the baselines of the original benchmark."""
    massless = controller._target_.endswith(("StraightLine", "OrcaPolicy"))
    world = World(
        robot=HolonomicRobot() if massless else instantiate(config.robot),
        crowd=instantiate(config.crowd),
        verdict=VERDICTS[config.verdict](DiscFootprint(), config.limit_s),
        dt_s=config.dt_s,
        robot_visible=config.robot_visible,
    )
    deciding = [controller, config.robot, config.verdict, config.crowd, config.robot_visible]
    told = f"{OmegaConf.to_yaml(OmegaConf.create(deciding))}{config.limit_s} {config.dt_s}"
    return Method(name, world, partial(instantiate, controller), told)


if __name__ == "__main__":
    main()
