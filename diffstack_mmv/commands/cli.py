"""What all command lines share.

Hydra's composition, one message per failure, and an exit status to trust.
"""

import functools
import gc
import logging
import math
import shlex
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from diffstack_mmv.commands.endings import endings_raised
from dmmv_conventions.extras import needs_to_run

with endings_raised(), needs_to_run("stack", "the command lines"):
    import hydra
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode
    from hydra.utils import get_class, instantiate
    from omegaconf import DictConfig, OmegaConf, read_write

    from diffstack_mmv.commands.child_processes import end_with_parent
    from diffstack_mmv.commands.command_line import folders_as, understood
    from diffstack_mmv.commands.composition import (
        as_written,
        change_again,
        changed_defaults,
        composed_once,
        is_in_part,
        refuse_beside,
        require_resolvable,
        require_resolved,
        settings_in,
        value_of,
    )
    from diffstack_mmv.commands.config_checks import (
        require_complete,
        require_same_type,
        require_seed,
    )
    from diffstack_mmv.commands.failures import composition_told, failures_told
    from diffstack_mmv.commands.new_folder import declare_new_folders
    from diffstack_mmv.commands.run_checks import (
        config_file,
        require_own_config,
        require_own_folder,
    )
    from diffstack_mmv.vehicles import VehicleSpec
    from dmmv_conventions.annotations import require_types
    from dmmv_conventions.arguments import require_arguments
    from dmmv_conventions.bars import Bars
    from dmmv_conventions.data_names import require_name_of_converter
    from dmmv_conventions.disk import replacing
    from dmmv_conventions.foretold import require_foretold
    from dmmv_conventions.locks import alone_in
    from dmmv_conventions.progress import shown_by
    from dmmv_conventions.targets import OF_A_RUN, nodes, require_buildable
    from dmmv_conventions.yaml_files import read_mapping

# what commands use of Hydra is taken from here, so that all of them say in one line what is missing
__all__ = [
    "DictConfig",
    "OmegaConf",
    "admit_any",
    "as_written",
    "command",
    "folders_as",
    "get_class",
    "instantiate",
    "refuse_beside",
    "save_config",
    "settings_in",
]

declare_new_folders()
# `${smaller:a,b}`, and the smallest turning radius of a vehicle
OmegaConf.register_new_resolver("smaller", min, replace=True)
OmegaConf.register_new_resolver(
    "turning_radius_m",
    lambda wheelbase_m, steer_max_rad: wheelbase_m / math.tan(steer_max_rad),
    replace=True,
)

_VEHICLE = "diffstack_mmv.vehicles.VehicleSpec.from_config"

Task = Callable[[DictConfig], float | None]
"""Work of a command; a number is what a sweeper minimises or maximises."""


def admit_any(config: DictConfig) -> None:
    """Admit every run to its folder."""


def command(
    config_folder: Path,
    config_name: str,
    check: Callable[[DictConfig], object] = OmegaConf.resolve,
    admit: Callable[[DictConfig], object] = admit_any,
) -> Callable[[Task], Callable[[], None]]:
    """Make a function of a composed configuration a command line.

    The resolved configuration goes into the run folder (`out=DIR`) as `config.yaml` before the work
    begins, so that every run can be repeated (not that of a `dry_run`; as `NAME_config.yaml` into
    the folder of another command's run); no other command works in that folder meanwhile. What the
    configuration has built is checked before, because parts of it may come from files. A bad input
    ends with one line and exit status 1; `HYDRA_FULL_ERROR=1` shows where it came from.

    Args:
        config_folder: The folder of the configuration groups.
        config_name: File in it, without its ending.
        check: Refuses, by raising, what cannot be run, before anything is written or imported; it
            gets the resolved configuration.
        admit: Refuses, by raising, a run that does not belong in its folder, before anything in it
            is replaced.
    """

    def decorate(task: Task) -> Callable[[], None]:
        @functools.wraps(task)
        def guarded(config: DictConfig) -> float | None:
            with failures_told():
                config.out = HydraConfig.get().runtime.output_dir
                _read_vehicle_file(config)
                _resolve(config, config_name)
                check(config)
                with alone_in(Path(config.out), "out"), _single_job():
                    require_own_folder(Path(config.out), config_name)
                    admit(config)
                    if not config.get("dry_run"):
                        save_config(config, config_file(Path(config.out), config_name))
                    gc.enable()
                    with shown_by(Bars()), _quiet_dependencies():
                        return task(config)

        entry = hydra.main(
            version_base="1.3", config_path=str(config_folder), config_name=config_name
        )(guarded)

        @functools.wraps(task)
        def main() -> None:
            end_with_parent()
            sys.argv[1:] = understood(sys.argv[1:], config_name)
            with (
                _no_search_for_garbage(),
                endings_raised(),
                composition_told(config_folder, config_name),
                composed_once(sys.argv[1:], _read_vehicle_file),
            ):
                entry()

        return main

    return decorate


def _resolve(config: DictConfig, config_name: str) -> None:
    """Resolve a configuration, and refuse what no command can run."""
    require_own_config(str(HydraConfig.get().job.config_name), config_name)
    require_complete(OmegaConf.to_container(config))
    defaults = changed_defaults(config_name)
    require_resolvable(config, defaults)
    for key, default in defaults.items():
        require_same_type(key, default, value_of(config, key), is_in_part(config, key))
    _judge_vehicle(config)  # before others compute with its numbers
    require_resolved(config)
    require_seed(config.get("seed"))
    content: Any = OmegaConf.to_container(config)
    require_buildable(content, OF_A_RUN, "in the configuration")
    _judge_vehicles(content)
    require_arguments(content, HydraConfig.get().overrides.task)
    require_types(content)
    require_foretold(content)
    require_name_of_converter(content.get("data"))


@contextmanager
def _no_search_for_garbage() -> Iterator[None]:
    """Until the work begins: composing and importing make no garbage that is worth a search."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def _tells_something(record: logging.LogRecord) -> bool:
    """Whether a line of Lightning says more than its advertisements and the settings again."""
    told = record.getMessage()
    return not (told.startswith(("💡 Tip", "TPU available")) or "was configured so" in told)


@contextmanager
def _quiet_dependencies() -> Iterator[None]:
    """Keep what packages deprecate from people who use none of it; PYTHONWARNINGS shows it."""
    lightning = logging.getLogger("pytorch_lightning.utilities.rank_zero")
    lightning.addFilter(_tells_something)
    with warnings.catch_warnings():
        if not sys.warnoptions:
            for category in (DeprecationWarning, PendingDeprecationWarning, FutureWarning):
                warnings.simplefilter("ignore", category)
            # scores are added up over the processes before they are logged
            warnings.filterwarnings("ignore", r".*self\.log\(.*sync_dist=True")
        try:
            yield
        finally:
            lightning.removeFilter(_tells_something)


def save_config(config: DictConfig, file: Path) -> None:
    """Write a configuration to a file, atomically, below the words of the command line."""
    words = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
    with replacing(file) as unfinished:
        text = f"# {shlex.join(words)}\n{OmegaConf.to_yaml(config)}"
        unfinished.write_text(text, encoding="utf-8")


def _read_vehicle_file(config: DictConfig) -> None:
    file = config.get("vehicle_file")
    if file is None:
        return
    path = Path(file)
    if not path.is_file():
        raise ValueError(f"`vehicle` must be a name or an existing YAML file, but got {file!r}.")
    config.vehicle = read_mapping(path, "vehicle")
    change_again(config, "vehicle")


def _judge_vehicle(config: DictConfig) -> None:
    """Have the vehicle that a command builds judge itself, for which it needs no tensor."""
    vehicle, written = value_of(config, "vehicle"), OmegaConf.to_container(config)
    if not isinstance(vehicle, Mapping) or not any(
        isinstance(node, Mapping) and node.get("_target_") == _VEHICLE for _, node in nodes(written)
    ):
        return
    try:
        VehicleSpec.from_config(vehicle)
    except ValueError as problem:
        file = config.get("vehicle_file")
        if file is None:
            raise
        raise ValueError(f"{problem} (file {file})") from problem


def _judge_vehicles(content: Any) -> None:
    """The same for vehicles that stand elsewhere."""
    for _, node in nodes(content):
        built = isinstance(node, dict) and node.get("_target_") == _VEHICLE
        if built and node["mapping"] != content.get("vehicle"):
            VehicleSpec.from_config(node["mapping"])


@contextmanager
def _single_job() -> Iterator[None]:
    """Have the command line of a job of a sweep (`-m`) name that job alone.

    Whoever starts further processes of a training repeats the command line in each of them.
    """
    job: Any = HydraConfig.get()
    before = list(sys.argv)
    if job.mode is not RunMode.MULTIRUN:
        yield
        return
    sys.argv[1:] = job.overrides.task
    with read_write(job):
        job.run.dir = job.runtime.output_dir
    try:
        yield
    finally:
        sys.argv[:] = before
