"""Create the W&B dashboard of a project."""

import logging

from diffstack_mmv.commands.cli import DictConfig, command
from diffstack_mmv.commands.data_checks import require_modes
from dmmv_conventions.checks import require
from dmmv_conventions.configs import config_folder

logger = logging.getLogger(__name__)


def check(config: DictConfig) -> None:
    """Refuse modes that nobody knows, and a dashboard of nobody."""
    require_modes(config.modes)
    remedy = "Add entity=USER_OR_TEAM."
    require(bool(config.entity), "entity", "be given", None, "", remedy)


@command(config_folder(), "dashboard", check)
def main(config: DictConfig) -> None:
    """Lay out the panels and save the view."""
    from diffstack_mmv.callbacks import build_dashboard

    address = build_dashboard(config.entity, config.project, list(config.modes))
    logger.info("Dashboard: %s", address)


if __name__ == "__main__":
    main()
