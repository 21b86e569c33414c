"""Export the optimiser of a planner as a shared library that needs no Python."""

import logging
from pathlib import Path

from diffstack_mmv.commands.cli import DictConfig, command, instantiate, refuse_beside
from diffstack_mmv.commands.config_checks import require_checkpoint
from dmmv_conventions.checks import require_at_least, require_positive
from dmmv_conventions.configs import config_folder
from dmmv_conventions.pretrained import checkpoint_path

logger = logging.getLogger(__name__)

REPLACED = "vehicle", "vehicle_file", "dynamics", "cost", "solver", "planner", "steps", "dt_s"
"""What the planner of a checkpoint brings along."""


def check(config: DictConfig) -> None:
    """Refuse sizes that are none, and a checkpoint that is not there or not all of the planner."""
    for name in ("agents", "components", "discs", "steps"):
        require_at_least(name, config[name], 1)
    require_positive("dt_s", config.dt_s)
    if config.checkpoint:
        require_checkpoint("checkpoint", config.checkpoint)
        refuse_beside("checkpoint", REPLACED)
    else:
        instantiate(config.planner)


@command(config_folder(), "export_planner", check)
def main(config: DictConfig) -> None:
    """Build the planner, or load it from a checkpoint; write library, header and source.

    Raises:
        ValueError: There is no library for it.
    """
    from diffstack_mmv.control.native.lowering import CannotLowerError
    from diffstack_mmv.planning.export import export_planner
    from dmmv_conventions.libraries import CannotBuildError

    if config.checkpoint:
        from diffstack_mmv.stack import load_stack

        planner = load_stack(checkpoint_path(config.checkpoint), "cpu")[0].planner
    else:
        planner = instantiate(config.planner)
    planner = planner.double() if config.double else planner.float()
    sizes = config.agents, config.components, config.discs
    try:
        written = export_planner(planner, Path(config.out), *sizes, machine=config.machine)
    except (CannotLowerError, CannotBuildError) as failure:
        raise ValueError(f"There is no library for this planner: {failure}") from failure
    logger.info("Library %s, declared in %s", written.library, written.header)


if __name__ == "__main__":
    main()
