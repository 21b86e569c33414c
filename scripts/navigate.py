"""Drive a vehicle through a crowd, case by case, beside its baselines."""

import logging
from collections.abc import Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diffstack_mmv.commands.cli import (
    DictConfig,
    OmegaConf,
    as_written,
    command,
    get_class,
    instantiate,
)
from diffstack_mmv.commands.drive_checks import require_drive, tell_unused
from diffstack_mmv.commands.records import log_record
from dmmv_conventions.configs import config_folder
from dmmv_conventions.pretrained import checkpoint_path
from dmmv_conventions.progress import counted
from dmmv_conventions.versions import code_version, file_hash

if TYPE_CHECKING:
    from diffstack_mmv.simulation import (
        Campaign,
        Chunk,
        RecordedCrossing,
        Scenario,
        World,
    )

logger = logging.getLogger(__name__)

STEP_S = 0.01
"""Step of a model that is only asked what it has."""


def check(config: DictConfig) -> None:
    """Refuse a world or a controller that cannot be built, before any baseline has driven."""
    written = as_written("navigate")
    driving = [controller for _, controller in _controllers(written)]
    tell_unused(config.names.controller, driving, written.people)
    for whose in ("actual", "believed"):
        _tell_unfelt_friction(whose, config[whose])
    require_drive(config, _cases(config))
    if config.names.controller == "ppo":
        import_module("diffstack_mmv.simulation.reinforcement")  # tells the extra that it needs
    driven = (config.actual, config.believed, config.search)
    for part in (config.scenario, config.world, config.controller, *driven):
        instantiate(part)


def _tell_unfelt_friction(whose: str, vehicle: DictConfig) -> None:
    """Warn of a friction that a model without tyres does not feel; in a sweep, another may."""
    if vehicle.friction is None:
        return
    if "friction" not in instantiate(vehicle).model(STEP_S).physical_parameters():
        logger.warning(
            "%s.friction=%s changes nothing: %s has no tyres. dynamics=gm3 has.",
            whose, vehicle.friction, vehicle.name,
        )  # fmt: skip


def admit(config: DictConfig) -> None:
    """Refuse a folder with episodes of other settings, and runs that cannot be compared."""
    if config.against:
        from diffstack_mmv.reporting import require_comparable

        for folder in config.against:
            require_comparable(_header(config), _cases(config), Path(folder))
    if not (Path(config.out) / "episodes").is_dir():
        return
    from diffstack_mmv.reporting import require_same_drive

    require_same_drive(Path(config.out), config.names.controller)
    scenario, world = instantiate(config.scenario), instantiate(config.world)
    for name, controller in _controllers(config):
        _campaign(config, scenario, world, name, controller).require_same_origin()


def _cases(config: DictConfig) -> range:
    return range(config.first_case, config.first_case + config.cases)


def _controllers(config: DictConfig) -> list[tuple[str, DictConfig]]:
    """The baselines that are asked for, and last the controller itself, which is no other one's."""
    own = config.names.controller
    baselines = (config.get("baselines") or {}).items()
    beside = [(str(n), each) for n, each in baselines if each and n in config.beside and n != own]
    return [*beside, (own, config.controller)]


def _campaign(
    config: DictConfig,
    scenario: "Scenario | RecordedCrossing",
    world: "World",
    name: str,
    controller: DictConfig,
) -> "Campaign":
    """What a controller drives, and where its episodes are kept."""
    from diffstack_mmv.simulation import Campaign, Method, world_for

    # an episode alone and in a batch differ by rounding: the size of a batch is a setting as well
    parts = OmegaConf.create([controller, config.world, _contents(config)])
    settings = f"{OmegaConf.to_yaml(parts)}chunk: {config.chunk}"
    place = world_for(world, get_class(controller._target_))
    method = Method(name, place, partial(instantiate, controller), settings, code_version())
    folder = Path(config.out) / "episodes" / name
    return Campaign(method, scenario, _cases(config), folder, config.chunk, config.phase)


def _contents(config: DictConfig) -> dict[str, str | None]:
    """Hashes of what may change at its place, for the header and for what tells runs apart.

    What forecasts and policy have learned, and the recordings.
    """
    learned = config.people_checkpoint
    files = {"people_checkpoint": learned and checkpoint_path(learned), "policy": config.policy}
    found: dict[str, str | None] = {"people_checkpoint": None}
    # what is read is known to be there, see `require_drive`; anything else changes nothing
    there = {name: Path(file) for name, file in files.items() if file and Path(file).is_file()}
    found |= {name: file_hash(file) for name, file in there.items()}
    if "recordings" in config.scenario:
        recordings = instantiate(config.scenario.recordings)
        found["recordings"] = recordings.source.identity()["content"]
    return found


def _header(config: DictConfig) -> dict[str, Any]:
    """What was driven; `drawn_by` is what the cases are drawn by, but for the recordings."""
    header: Any = OmegaConf.to_container(config.header)
    drawn_by: Any = OmegaConf.to_container(config.scenario)
    drawn_by.pop("recordings", None)
    return header | {"drawn_by": drawn_by} | _contents(config)


@command(config_folder(), "navigate", check, admit)
def main(config: DictConfig) -> None:
    """Run the benchmark of the controller and of its baselines; write tables, plots, animations."""
    import torch

    from diffstack_mmv.metrics import CLOSED_LOOP
    from diffstack_mmv.reporting import paired_cases, paired_with_run, write_closed_loop
    from diffstack_mmv.simulation import models_told, require_stoppable, summarise

    torch.manual_seed(config.seed)
    scenario, world = instantiate(config.scenario), instantiate(config.world)
    actual, believed = instantiate(config.actual), instantiate(config.believed)
    require_stoppable(actual, 2 * scenario.circle_radius_m)
    out = Path(config.out)

    campaigns = {
        name: _campaign(config, scenario, world, name, each) for name, each in _controllers(config)
    }
    own = campaigns.pop(config.names.controller)
    rows = {name: summarise(list(each.run())) for name, each in campaigns.items()}
    chunks = list(own.run())
    for campaign in (*campaigns.values(), own):
        campaign.remove_parts()
    header = _header(config)
    # a reactive crowd sees the robot whatever the configuration says
    header |= {"code": code_version(), "robot_visible": world.robot_visible}
    place = own.method.world
    header |= models_told(actual, believed, place, instantiate(config.model))
    result = header | summarise(chunks)
    search = instantiate(config.search)
    # a massless robot goes as fast as its controller says, so that no bounds are to be searched
    if search is not None and place is world:
        result["feasible"] = search.judge(world, scenario, config.phase, result["cases"])
    published = [dict(each) for each in config.get("published") or ()]
    pairs = [{"other": name} | paired_cases(result["cases"], rows[name]["cases"]) for name in rows]
    pairs += [paired_with_run(result, Path(folder)) for folder in config.against]
    write_closed_loop(out, result, rows, CLOSED_LOOP, published, pairs)
    _draw(config, own, chunks)
    _tell_times(result)
    log_record(config)
    logger.info("Report: %s; as a page: dmmv-report %s", out / "closed_loop.md", out)


def _draw(config: DictConfig, driven: "Campaign", chunks: Sequence["Chunk"]) -> None:
    """Write pictures and animations of the cases that the controller drove."""
    from diffstack_mmv.plotting import CaseStart, episode_of, save_story, worth_showing

    rows = {case: (each.record, row) for each in chunks for row, case in enumerate(each.cases)}
    outcomes = {case: int(record.outcome[row]) for case, (record, row) in rows.items()}
    robot = driven.method.world.robot
    outline, control_names = robot.footprint.outline(), robot.control_names
    shown = worth_showing(outcomes, config.animate, config.show)
    for case in counted(shown, "draw episodes", "case"):
        start = CaseStart(*driven.scenario.case(driven.phase, case).radii_and_goal())
        drawn = episode_of(*rows[case], case, start, outline)
        drawn = drawn._replace(thoughts=driven.thoughts(case), control_names=control_names)
        save_story(Path(config.out), drawn, config.movie)


def _tell_times(result: Mapping[str, Any]) -> None:
    """Say whether the decisions keep up with the vehicle, and how many solves converge."""
    solved, time_ms = result["solved_share"], result["control_time_ms"]
    logger.info(
        "Real-time factor %.1f (time driven over processor time of the decisions), median %.1f ms, "
        "99th percentile %.1f ms per decision and episode%s.",
        result["real_time_factor"], time_ms["median"], time_ms["p99"],
        "" if solved is None else f"; {100 * solved:.0f} % of the solves converge",
    )  # fmt: skip


if __name__ == "__main__":
    main()
