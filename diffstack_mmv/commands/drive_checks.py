"""Checks of what a configuration says of a drive among people; nothing heavy is needed.

As in `config_checks`, a mistake is told before what takes seconds is imported.
"""

import logging
import zipfile
from importlib import import_module
from pathlib import Path

from omegaconf import DictConfig

from diffstack_mmv.commands.config_checks import require_checkpoint, require_file
from dmmv_conventions.cache import SPLITS
from dmmv_conventions.checks import require, require_at_least, require_one_of
from dmmv_conventions.config_files import names_in
from dmmv_conventions.configs import config_folder
from dmmv_conventions.extras import needs

logger = logging.getLogger(__name__)


def require_drive(config: DictConfig, cases: range) -> None:
    """Refuse settings of a drive that do not fit together; warn of a baseline that does not drive.

    Args:
        config: Configuration of the command `navigate`.
        cases: The cases that are driven.

    Raises:
        ValueError: A name or a number is out of its range, a file that is read is not there, or the
            steps of controller and world differ.
    """
    require_one_of("phase", config.phase, SPLITS)
    if "predictor" in config.people:
        require_checkpoint("people_checkpoint", config.people.predictor.path)
    if config.names.controller == "ppo":
        _require_policy(config.policy)
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
