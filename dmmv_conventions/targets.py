"""What a file may have built: classes of this project and a short list of others.

A checkpoint, the configuration of a run and the file of a vehicle name what is built from them by
`_target_`, and Hydra would call any function by its name. So everything that comes from a file is
looked through before it is built.
"""

import importlib
import inspect
import os
import re
from collections.abc import Iterator, Mapping
from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

from dmmv_conventions.checks import message
from dmmv_conventions.configs import config_folder

TRUSTED_VARIABLE = "DMMV_TRUSTED_PACKAGES"
"""Environment variable with the packages of one's own whose names a file may hold, by commas."""

PROJECT = ("dmmv_conventions", "data_converters", "diffstack_mmv")

_STACK = ("control", "costs", "dynamics", "metrics", "planning", "prediction", "stack", "vehicles")
_RUN = ("callbacks", "data", "identification", "simulation")


class Buildable(NamedTuple):
    """What may be built.

    Attributes:
        packages: Packages all of whose classes may be built; `apart` are modules left out.
        names: Dotted names of functions of this project, and of classes of others.
    """

    packages: tuple[str, ...]
    names: frozenset[str]
    apart: tuple[str, ...] = ()


def _of(package: str, names: str) -> frozenset[str]:
    return frozenset(f"{package}.{name}" for name in names.split())


OF_A_STACK = Buildable(
    tuple(f"diffstack_mmv.{part}" for part in _STACK),
    _of("diffstack_mmv.checks", "require_multiple")
    | _of("diffstack_mmv.vehicles", "VehicleSpec.from_config load_vehicle")
    | _of("diffstack_mmv.stack", "assemble")
    | _of("diffstack_mmv.planning", "above_rest generated_moments")
    | _of("diffstack_mmv.metrics", "average_displacement mean_square_displacement")
    | _of(
        "diffstack_mmv.prediction",
        "without_dynamics straight_line constant_acceleration hermite_spline"
        " trajectron.linearise_shared",
    )
    | _of("torch.optim", "Adam AdamW NAdam RAdam RMSprop SGD")
    | _of(
        "torch.optim.lr_scheduler",
        "ConstantLR CosineAnnealingLR ExponentialLR LinearLR MultiStepLR OneCycleLR StepLR",
    ),
)
"""What a checkpoint may hold."""

OF_A_RUN = Buildable(
    (*OF_A_STACK.packages, *(f"diffstack_mmv.{part}" for part in _RUN), "data_converters"),
    OF_A_STACK.names
    | _of("diffstack_mmv.stack", "load_predictor")
    | _of(
        "diffstack_mmv.simulation",
        "actuation controller_model study_world vehicle_footprint vehicle_robot",
    )
    # refused by `train` itself, which knows why
    | _of("torch.optim.lr_scheduler", "ReduceLROnPlateau")
    | _of("pathlib", "Path")
    | _of("pytorch_lightning", "Trainer")
    | _of(
        "pytorch_lightning.callbacks",
        "EMAWeightAveraging EarlyStopping LearningRateMonitor ModelCheckpoint ModelSummary"
        " RichProgressBar StochasticWeightAveraging TQDMProgressBar Timer",
    )
    | _of("pytorch_lightning.loggers", "CSVLogger TensorBoardLogger WandbLogger")
    | _of("pytorch_lightning.strategies", "DDPStrategy FSDPStrategy"),
    # open the pickles of a cache when they are built
    apart=("diffstack_mmv.data.registration", "diffstack_mmv.data.scene_table"),
)
"""What the configuration of a command may hold."""

NOTHING = Buildable((), frozenset())
"""For files that hold plain values only."""

_BY_NAME = "hydra.utils.get_method"
_REMEDY = (
    "Open only files whose origin you know; a package of your own is allowed by "
    f"{TRUSTED_VARIABLE}=NAME."
)


def require_buildable(
    content: Any, allowed: Buildable, where: str, error: type[ValueError] = ValueError
) -> None:
    """Refuse content that would build anything but what is allowed, however deep it stands.

    Args:
        content: Plain containers; interpolations have to be resolved.
        allowed: What may be built.
        where: The file with its preposition ("in a.ckpt"), for the message.
        error: Class of the error.

    Raises:
        ValueError: A `_target_` is not allowed, is no text, or a text would still be interpolated;
            of class `error`.
    """
    for place, node in nodes(content):
        if isinstance(node, str) and "${" in node:
            told, needed = f"{node!r} at {place}", "hold resolved values"
            raise error(message("configuration", needed, told, where, _REMEDY))
        if isinstance(node, Mapping) and "_target_" in node:
            name = node["_target_"]
            if name == _BY_NAME and set(node) == {"_target_", "path"}:
                name = node["path"]
            if not (isinstance(name, str) and _is_allowed(name, allowed)):
                told, needed = (
                    f"{name!r} at {place or 'the top'}",
                    "name what a file may have built",
                )
                raise error(message("_target_", needed, told, where, _REMEDY))


def trusted_packages() -> list[str]:
    """Packages of one's own whose names a file may hold, as the environment tells."""
    told = os.environ.get(TRUSTED_VARIABLE, "").split(",")
    return [each.strip() for each in told if each.strip()]


def nodes(content: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """All containers and values with their dotted places, outer ones first; no recursion."""
    pending = [(place, content)]
    while pending:
        place, node = pending.pop()
        yield place, node
        if isinstance(node, Mapping):
            pending += [(f"{place}.{key}".lstrip("."), value) for key, value in node.items()]
        elif isinstance(node, list | tuple):
            pending += [(f"{place}[{index}]", value) for index, value in enumerate(node)]


def parts(content: Any) -> list[tuple[str, Mapping[str, Any]]]:
    """What is built, with its place; a group stands before the parts that it is handed to.

    Args:
        content: Plain containers; interpolations have to be resolved.

    Returns:
        Place and settings of each, those nearer to the top first.
    """
    built = [
        (place, node)
        for place, node in nodes(content)
        if isinstance(node, Mapping) and "_target_" in node
    ]
    return sorted(built, key=lambda part: (part[0].count("."), part[0]))


def _is_allowed(name: str, allowed: Buildable) -> bool:
    if name in allowed.names or (allowed is OF_A_RUN and name in _shipped()):
        return True
    package = name.partition(".")[0]
    if package in trusted_packages() and allowed is not NOTHING:
        return True
    if package not in PROJECT or not allowed.packages:
        return False
    found = _located(name)
    if not inspect.isclass(found) or found.__module__ in allowed.apart:
        return False
    return f"{found.__module__}.".startswith(tuple(f"{each}." for each in allowed.packages))


@cache
def _shipped() -> frozenset[str]:
    """Names in the configuration that comes with the package, which need no import to be known."""
    files = config_folder().rglob("*.yaml")
    named = re.compile(r"(?:_target_|path): *([A-Za-z_][\w.]*)")
    found = {name for file in files for name in named.findall(file.read_text(encoding="utf-8"))}
    return frozenset(name for name in found if "." in name and not name.startswith("hydra."))


def _located(name: str) -> object:
    """What a dotted name of this project stands for; None where it leads out of it or nowhere."""
    first, *rest = name.split(".")
    found: Any = importlib.import_module(first)
    place = first
    for part in rest:
        place = f"{place}.{part}"
        inner = getattr(found, part, None)
        if inner is None and isinstance(found, ModuleType):
            inner = _imported(place)
        if isinstance(inner, ModuleType) and inner.__name__.partition(".")[0] not in PROJECT:
            return None
        found = inner
    return found


def _imported(name: str) -> ModuleType | None:
    try:
        return importlib.import_module(name)
    except (ImportError, ValueError):
        return None
