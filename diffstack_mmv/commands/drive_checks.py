"""Checks of what a configuration says of a drive among people; nothing heavy is needed.

As in `config_checks`, a mistake is told before what takes seconds is imported.
"""

import logging
import re
import zipfile
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

from omegaconf import DictConfig, OmegaConf

from diffstack_mmv.commands.composition import given_settings
from diffstack_mmv.commands.config_checks import require_checkpoint, require_file
from dmmv_conventions.cache import SPLITS
from dmmv_conventions.checks import message, require, require_at_least, require_one_of
from dmmv_conventions.config_files import names_in
from dmmv_conventions.configs import config_folder
from dmmv_conventions.differences import first_difference
from dmmv_conventions.extras import needs
from dmmv_conventions.yaml_files import read_plain

logger = logging.getLogger(__name__)

READERS: Mapping[str, str] = MappingProxyType(
    {
        "known_delay_s": "controller=diffmpc_delay does; the robot's delay is robot.delay_s",
        "people_checkpoint": "people=predictor does",
        "policy": "controller=ppo does",
        "people": "controller=diffmpc does",
        "cost": "controller=diffmpc does",
        "constraints": "controller=diffmpc does",
    }
)
"""Settings that not everybody who drives uses, and who does."""


def tell_unused(controller: str, driving: Sequence[DictConfig], people: DictConfig) -> None:
    """Warn of given settings that nobody who drives uses; in a sweep, another job's may.

    Args:
        controller: Name of the controller, for the warning.
        driving: It and who drives beside it, with their interpolations.
        people: The forecast of the people, likewise.
    """
    given = given_settings()
    for name in (name for name in READERS if name in given):
        reference = re.compile(rf"\$\{{{name}[.}}]")
        parts = driving if name == "people" else [*driving, people]
        if not any(reference.search(OmegaConf.to_yaml(part)) for part in parts):
            logger.warning(
                "%s=%s changes nothing: neither controller=%s nor who drives beside it uses it. "
                "%s.", name, given[name], controller, READERS[name],
            )  # fmt: skip


def require_drive(config: DictConfig, cases: range) -> None:
    """Refuse settings of a drive that do not fit together; warn of a baseline that does not drive.

    Args:
        config: Configuration of the command `navigate`.
        cases: The cases that are driven.

    Raises:
        ValueError: A name or a number is out of its range, a file that is read is not there, or the
            steps of controller and world differ, or a policy was trained for another vehicle.
    """
    require_one_of("phase", config.phase, SPLITS)
    if "predictor" in config.people:
        require_checkpoint("people_checkpoint", config.people.predictor.path)
    if config.names.controller == "ppo":
        _require_policy(config.policy)
        require_trained_for(config)
    require_at_least("animate", config.animate, 0)
    require_movie(config.movie)
    known = names_in(config_folder() / "controller")
    for name in config.beside:
        require_one_of("beside", name, known)
        if name not in (config.get("baselines") or ()):
            logger.warning("%s of `beside` is no baseline of this run: it does not drive.", name)
    for folder in config.against:
        require_file("against", str(Path(folder) / "closed_loop.json"), "Give runs of navigate.py.")
    for case in config.show:
        require(case in cases, "show", "be among the cases that are driven", case)
    same = config.dt_s == config.model.dt_s
    remedy = f"Give model.dt_s={config.dt_s} too; planner.steps are steps of it."
    require(same, "dt_s", f"be that of the controller's model, {config.model.dt_s}", config.dt_s,
            "", remedy)  # fmt: skip
    remedy = "Add search=null, or search.samples=NUMBER."
    named = isinstance(config.search, str)
    require(not named, "search", "be settings of a search or none", config.search, "", remedy)


def require_movie(movie: str) -> None:
    """Refuse a format of moving pictures that is none, or that nothing installed can write.

    Args:
        movie: The format, gif or mp4.

    Raises:
        ValueError: It is another one.
        MissingExtraError: It is mp4, and the extra `video` is not installed.
    """
    require_one_of("movie", movie, ("gif", "mp4"))
    if movie == "mp4":
        with needs("video", "moving pictures as MP4"):
            import_module("imageio_ffmpeg")


def _require_policy(policy: str | None) -> None:
    """Refuse a policy that is not there, or no archive as stable-baselines3 writes it."""
    remedy = "Train one: dmmv-train-policy, policy=DIR/policy.zip."
    require_file("policy", policy, remedy)
    whole = zipfile.is_zipfile(str(policy))
    require(whole, "policy", "be readable", "no archive", f"in {policy}", remedy)


def require_trained_for(config: DictConfig) -> None:
    """Refuse a policy for what it was not trained with: its shares of the bounds mean other things.

    A file beside it tells; the robot may still differ from what the controller believes.

    Args:
        config: Configuration of the command `navigate`.

    Raises:
        ValueError: Vehicle, dynamics, limits, step or view differ from those of the training.
    """
    file = Path(config.policy).parent / "config.yaml"
    trained = read_plain(file, "policy") if file.is_file() else {}
    if not {"training", "actual", "dt_s", "view"} <= trained.keys():
        logger.warning(
            "No config.yaml of train_policy beside %s tells what it was trained with: it drives %s "
            "(%s) all the same.", config.policy, config.vehicle.name, config.names.dynamics,
        )  # fmt: skip
        return
    now: Any = OmegaConf.to_container(config)
    before = _driven_by(trained["actual"], trained["dt_s"], trained["view"])
    after = _driven_by(now["believed"], now["dt_s"], now["controller"]["view"])
    for first, second in zip(before, after, strict=True):
        if (found := first_difference(first, second)) is not None:
            wanted = f"be that of the policy's training, {found.before!r}"
            remedy = "Give it so, or train a policy for this one (dmmv-train-policy)."
            place = f"(training: {file})"
            raise ValueError(message(found.place, wanted, repr(found.now), place, remedy))


def _driven_by(
    vehicle: Mapping[str, Any], dt_s: float, view: Mapping[str, Any]
) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """What gives the numbers of a policy their meaning: names, and all that stands behind them."""
    names = {"vehicle": vehicle["vehicle"]["name"], "dynamics": vehicle["name"], "dt_s": dt_s}
    settings = {name: vehicle[name] for name in ("vehicle", "limits")}
    return names, settings | {"controller": {"view": view}}
