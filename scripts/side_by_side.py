"""Show several controllers in the same cases, side by side."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diffstack_mmv.commands.cli import DictConfig, command, get_class, instantiate
from diffstack_mmv.commands.config_checks import require_file
from diffstack_mmv.commands.drive_checks import require_movie
from dmmv_conventions.checks import message, require
from dmmv_conventions.configs import config_folder
from dmmv_conventions.differences import first_difference
from dmmv_conventions.targets import OF_A_RUN, require_buildable
from dmmv_conventions.yaml_files import read_plain

if TYPE_CHECKING:
    from diffstack_mmv.simulation import Robot

logger = logging.getLogger(__name__)

OF_A_CASE = ("phase", "scenario")
"""By what the number of a case is a case, in the configuration of a drive."""
REMEDY = "Give folders DIR/episodes/NAME that navigate wrote."


def check(config: DictConfig) -> None:
    """Refuse folders that are no episodes of a run, and an unknown format.

    Raises:
        ValueError: A setting is none of those, or the runs are of different cases.
    """
    require(len(config.runs) >= 2, "runs", "name at least two", list(config.runs), "", REMEDY)
    require(len(config.cases) >= 1, "cases", "name at least one", "[]", "", "Give cases=[0].")
    require_movie(config.movie)
    named = len(config.names) in (0, len(config.runs))
    require(named, "names", "be one per run, or none", list(config.names))
    for run in config.runs:
        beside = Path(run).parent.name
        require(beside == "episodes", "runs", "be folders of episodes", run, "", REMEDY)
        require_file("runs", str(_file(run)), REMEDY)
    first, *others = config.runs
    for run in others:
        found = first_difference(_cases_of(first), _cases_of(run))
        if found is not None:
            wanted = f"be drives of one {found.place}, {found.before!r} as in {first}"
            raise ValueError(message("runs", wanted, repr(found.now), f"in {run}"))


def names_of(runs: Sequence[Path]) -> list[str]:
    """Names of controllers; where two have the same one, with the folders of their drives."""
    names = [run.name for run in runs]
    if len(set(names)) == len(names):
        return names
    return [f"{run.name} in {run.parent.parent.name}" for run in runs]


def _cases_of(run: str) -> dict[str, Any]:
    """By what the number of a case is a case."""
    settings = _settings(run)
    return {name: settings[name] for name in OF_A_CASE}


def _file(run: str | Path) -> Path:
    """Where the configuration of the drive stands whose episodes these are."""
    return Path(run).parent.parent / "config.yaml"


def _settings(run: str | Path) -> dict[str, Any]:
    """The configuration of a drive, which may come from somebody else.

    Raises:
        ValueError: It is broken, that of another command, or builds what a file may not.
    """
    file = _file(run)
    settings = read_plain(file, "runs", REMEDY)
    absent = [name for name in OF_A_CASE if name not in settings]
    require(not absent, "runs", "be drives", f"no {' and no '.join(absent)}", f"in {file}", REMEDY)
    require_buildable(settings, OF_A_RUN, f"in {file}")
    return settings


def robot_of(run: Path, settings: Mapping[str, Any]) -> Robot:
    """The robot of these episodes: beside a vehicle, massless baselines drive one of their own."""
    from diffstack_mmv.simulation import HolonomicRobot, is_massless

    driver = (settings.get("baselines") or {}).get(run.name) or settings["controller"]
    massless = is_massless(get_class(driver["_target_"]))
    return HolonomicRobot() if massless else instantiate(settings["robot"])


@command(config_folder(), "side_by_side", check)
def main(config: DictConfig) -> None:
    """Write a picture and a moving picture of every case."""
    from diffstack_mmv.plotting import (
        CaseStart,
        Episode,
        draw_side_by_side,
        episode_of,
        save_figure,
        save_side_by_side,
    )
    from diffstack_mmv.simulation import read_episode, read_thoughts

    runs, out = [Path(run) for run in config.runs], Path(config.out)
    names = list(config.names) or names_of(runs)

    def episode(run: Path, case: int) -> Episode:
        settings = _settings(run)
        scenario, robot = instantiate(settings["scenario"]), robot_of(run, settings)
        record, row = read_episode(run, case)
        outline = robot.footprint.outline()
        start = CaseStart(*scenario.case(settings["phase"], case).radii_and_goal())
        drawn = episode_of(record, row, case, start, outline)
        return drawn._replace(thoughts=read_thoughts(run, case))

    for case in config.cases:
        episodes = [episode(run, case) for run in runs]
        save_figure(draw_side_by_side(names, episodes), out / f"case_{case}.png")
        save_side_by_side(names, episodes, out / f"case_{case}.{config.movie}")
        logger.info("%s", out / f"case_{case}.{config.movie}")


if __name__ == "__main__":
    main()
