"""A configuration is composed once for a command.

Left to itself Hydra composes it a second time to find its mode, and the defaults that values are
compared with would be a third: half a second of the time until a mistake is told.
"""

import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from hydra import compose
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.hydra import Hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import InterpolationResolutionError, OmegaConfBaseException

from diffstack_mmv.commands.config_checks import leaves
from dmmv_conventions.checks import message, require

_ELSEWHERE = ("--config", "-cd", "-cn", "-cp", "hydra")
"""What in a command line may change the mode of Hydra, besides its own options for that."""
_DEFAULTS: ContextVar[Mapping[str, Any] | None] = ContextVar("defaults", default=None)


@contextmanager
def composed_once(
    arguments: Sequence[str], complete: Callable[[DictConfig], object]
) -> Iterator[None]:
    """Have Hydra keep the defaults of what it composes, and leave its mode to its own options.

    What it shows (`--cfg`) is what a job would work with.

    No configuration of this package sets a mode; one of somebody else may.

    Args:
        arguments: The command line without its first word.
        complete: Puts into a composed configuration what a job reads from files besides.
    """
    mode, applied = Hydra.get_mode, ConfigLoaderImpl._apply_overrides_to_config
    without_hydra = Hydra.get_sanitized_cfg

    def keep_defaults(overrides: list[Override], cfg: DictConfig) -> None:
        _DEFAULTS.set({key: value_of(cfg, key) for key in _changed(overrides)})
        applied(overrides, cfg)

    def completed(self: Hydra, cfg: DictConfig, cfg_type: str) -> DictConfig:
        if HydraConfig.initialized():
            complete(cfg)
        return without_hydra(self, cfg, cfg_type)

    def no_mode(*_: Any, **__: Any) -> None:
        """What it would find."""

    if not any(begin in argument for argument in arguments for begin in _ELSEWHERE):
        Hydra.get_mode = no_mode
    ConfigLoaderImpl._apply_overrides_to_config = staticmethod(keep_defaults)
    Hydra.get_sanitized_cfg = completed
    try:
        yield
    finally:
        Hydra.get_mode = mode
        ConfigLoaderImpl._apply_overrides_to_config = staticmethod(applied)
        Hydra.get_sanitized_cfg = without_hydra


def changed_defaults(config_name: str) -> Mapping[str, Any]:
    """Key -> default of each value that the command line of the present job changes.

    The default is that of the same groups. `+key` and `++key` are not looked at.

    Args:
        config_name: Name of the configuration, for a job that a launcher has started elsewhere.
    """
    kept = _DEFAULTS.get()
    if kept is not None:
        return kept
    job = HydraConfig.get()
    parsed = OverridesParser.create().parse_overrides(list(job.overrides.task))
    keys = [key for key in _changed(parsed) if key.partition("@")[0] not in job.runtime.choices]
    others = [str(each.input_line) for each in parsed if each.get_key_element() not in keys]
    defaults = compose(config_name, others) if keys else OmegaConf.create()
    return {key: value_of(defaults, key) for key in keys}


def change_again(config: DictConfig, key: str) -> None:
    """Have the command line of the present job change what a file has put under a key since.

    Args:
        config: The configuration.
        key: The key; what is below it is changed.
    """
    words = list(HydraConfig.get().overrides.task)
    for each in OverridesParser.create().parse_overrides(words):
        parent, _, name = each.key_or_group.rpartition(".")
        if not f"{parent}.".startswith(f"{key}."):
            continue
        if not each.is_delete():
            OmegaConf.update(config, each.key_or_group, each.value(), merge=True, force_add=True)
        elif (node := OmegaConf.select(config, parent)) is not None:
            with open_dict(node):
                node.pop(name, None)


def as_written(config_name: str) -> DictConfig:
    """The configuration of the present job with its interpolations, which the job has resolved.

    Args:
        config_name: Name of the configuration.
    """
    words: Any = OmegaConf.to_container(HydraConfig.get().overrides.task, resolve=False)
    return compose(config_name, words)


def settings_in(words: Iterable[str]) -> dict[str, Any]:
    """Key -> value that the words of a command line leave it, whether it is changed or added.

    Raises:
        ValueError: A word is no setting.
    """
    found: dict[str, Any] = {}
    parser = OverridesParser.create()
    for word in words:
        try:
            parsed = parser.parse_override(word)
        except HydraException as error:
            raise ValueError(message("settings", "read key=value", repr(word))) from error
        key = parsed.get_key_element().lstrip("+~")
        found.pop(key, None)
        if not parsed.is_delete():
            found[key] = parsed.value()
    return found


def given_settings() -> dict[str, Any]:
    """Key -> value of each setting on the command line of the present job, groups as well."""
    return settings_in(HydraConfig.get().overrides.task)


def refuse_beside(argument: str, replaced: Collection[str]) -> None:
    """Refuse settings of the present job that another one replaces: they would change nothing.

    Args:
        argument: The setting that replaces them.
        replaced: Groups or keys that it replaces, each with all that is below it.

    Raises:
        ValueError: The command line has one of them.
    """
    for key in given_settings():
        name = key.partition("@")[0].partition(".")[0]
        remedy = f"Leave out {name}, or {argument}."
        require(name not in replaced, argument, "be without what it replaces", key, "", remedy)


def _changed(overrides: Sequence[Override]) -> list[str]:
    """Keys of values, and of groups if there are any, that exist already; not those of Hydra."""
    return [
        each.get_key_element()
        for each in overrides
        if each.type is OverrideType.CHANGE and not each.is_hydra_override()
    ]


def value_of(config: DictConfig, key: str) -> Any:
    """Value of a key in plain containers, none where it has none yet."""
    try:
        return _resolved(config, key)
    except OmegaConfBaseException:
        return None


def require_resolvable(config: DictConfig, keys: Iterable[str]) -> None:
    """Refuse values that are interpolations of nothing, or of themselves.

    Args:
        config: A configuration.
        keys: Of the values.

    Raises:
        ValueError: One leads to no value.
    """
    for key in keys:
        try:
            _resolved(config, key)
        except InterpolationResolutionError as error:
            found = f"an interpolation that leads to none ({str(error).splitlines()[0]})"
            raise ValueError(message(key, "be a value", found)) from error


def require_resolved(config: DictConfig) -> None:
    """Put its value in the place of every interpolation.

    Args:
        config: A configuration.

    Raises:
        ValueError: One leads to no value, or its formula does not take the values it is given.
    """
    try:
        OmegaConf.resolve(config)
    except InterpolationResolutionError:
        written = leaves("", OmegaConf.to_container(config))
        require_resolvable(config, (key for key, value in written if "${" in str(value)))
        raise


def is_in_part(config: DictConfig, key: str) -> bool:
    """Whether a key belongs to something that is built from it: a part, or the vehicle.

    Args:
        config: A configuration.
        key: Names and dots.
    """
    places = itertools.accumulate(key.split(".")[:-1], "{}.{}".format)
    above = ((place, value_of(config, place)) for place in places)
    return any(
        place == "vehicle" or (isinstance(found, Mapping) and "_target_" in found)
        for place, found in above
    )


def _resolved(config: DictConfig, key: str) -> Any:
    value = OmegaConf.select(config, key, throw_on_missing=False)
    return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value
