"""A trained stack from its checkpoint alone, without running code that stands in it."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from hydra.errors import HydraException
from hydra.utils import instantiate
from torch import Tensor

from diffstack_mmv.checks import message, require
from diffstack_mmv.prediction import Ensemble, Predictor, Trajectron
from diffstack_mmv.prediction.trajectron.agent_batch import PEDESTRIAN
from diffstack_mmv.stack.module import DiffStackMMV
from dmmv_conventions.checkpoints import read_plain
from dmmv_conventions.differences import differences
from dmmv_conventions.disk import replacing
from dmmv_conventions.pretrained import checkpoint_path
from dmmv_conventions.targets import OF_A_STACK, require_buildable

_logger = logging.getLogger(__name__)

BUILT_FROM = (
    "stack",
    "vehicle",
    "modes",
    "names",
    "seed",
    "dt_s",
    "history_s",
    "horizon_s",
    "horizon_steps",
)
"""Parts of the configuration of a training that a lean checkpoint keeps."""
_REMEDY = "Give the path of a checkpoint that scripts/train.py wrote."


class TrainedStack(NamedTuple):
    """A stack in evaluation mode, and the configuration it was trained with."""

    stack: DiffStackMMV
    config: dict[str, Any]


def load_stack(path: Path | str, device: torch.device | str = "cpu") -> TrainedStack:
    """Build the stack that a checkpoint describes, and load its weights.

    The file may name what is built: only classes of this project and the short list of
    `dmmv_conventions/targets.py` are, whatever else it names is refused.

    Args:
        path: The checkpoint, or the name of a shipped one: pretrained, pretrained/gm3.
        device: Where the stack is to be.

    Raises:
        ValueError: No checkpoint of that name is shipped, or the file is missing, broken, of
            another program, names what a file may not have built, or is of another architecture
            than this version builds.
    """
    path = checkpoint_path(path)
    config = read_checkpoint(path)["provenance"]["config"]
    require_buildable(config["stack"], OF_A_STACK, f"in {path}")
    try:
        stack = instantiate(config["stack"])
    except HydraException as fault:
        raise ValueError(_unbuildable(fault.__cause__ or fault, path)) from fault
    found = type(stack).__name__
    requirement = "describe a stack"
    require(isinstance(stack, DiffStackMMV), "checkpoint", requirement, found, f"in {path}")
    load_weights(stack, path)
    return TrainedStack(stack.eval().to(device), config)


def _unbuildable(cause: BaseException, path: Path) -> str:
    """The message for a stack that could not be built; Hydra tells in two lines what it misses."""
    lines, missing = f"{type(cause).__name__}: {cause}".splitlines(), isinstance(cause, ImportError)
    told = " ".join(lines[: 2 if missing else 1])
    own = "A package of your own has to be installed, or its folder to be in PYTHONPATH."
    wanted = "describe a stack that this version builds"
    return message("checkpoint", wanted, told, f"in {path}", own if missing else _REMEDY)


def load_ensemble(paths: Sequence[Path | str], device: torch.device | str = "cpu") -> TrainedStack:
    """Build the stack of the first checkpoint, whose predictor is the mixture of those of all.

    Raises:
        ValueError: See `load_stack`, or the predictors differ in horizon or step.
    """
    first, *others = [load_stack(path, device) for path in paths]
    if others:
        members = [each.stack.predictor for each in (first, *others)]
        first.stack.predictor = Ensemble(members).eval()
    return first


def load_predictor(path: Path | str | None) -> Predictor:
    """Return the predictor of a trained stack, or of a shipped one, in evaluation mode.

    Where nobody on foot was beside an ego in its training, which leaves their forecasts straight
    lines, a warning says so.

    Raises:
        ValueError: No path is given, or there is no usable checkpoint, see `load_stack`.
    """
    if path is None:
        raise ValueError(message("checkpoint", "be given for the predictor", path, "", _REMEDY))
    predictor = load_stack(path).stack.predictor
    if (
        isinstance(predictor, Trajectron)
        and predictor.forecast_neighbors
        and not predictor.has_learned(PEDESTRIAN)
    ):
        _logger.warning(
            "The predictor of %s has seen no pedestrian beside an ego: it forecasts them along a "
            "straight line. Train on data with neighbors to have more.",
            path,
        )
    return predictor


def load_weights(stack: DiffStackMMV, path: Path) -> None:
    """Give a stack the weights of a checkpoint.

    Raises:
        ValueError: The file is missing, broken, of another program, or of a stack of another
            architecture.
    """
    _load(stack, read_checkpoint(path)["state_dict"], path)


def start_from(stack: DiffStackMMV, path: Path, config: Mapping[str, Any] | None = None) -> None:
    """Give a stack the weights of a checkpoint, also of one with other dynamics of the ego.

    Physical parameters are taken over only from the same dynamics; a stack with other dynamics
    keeps its own, so that one trained predictor can start the training with every vehicle.

    Args:
        stack: Its weights are replaced.
        path: The checkpoint.
        config: What the stack was built from, as `provenance` of a checkpoint tells it; a refusal
            then names the settings of the predictor that differ.

    Raises:
        ValueError: The file is missing, broken, of another program, or of a stack of another
            architecture.
    """
    content = read_checkpoint(path)
    given = content["state_dict"]
    places = tuple(
        f"{name}."
        for name, module in stack.named_modules(remove_duplicate=False)
        if module is stack.planner.dynamics
    )
    own = {key: value for key, value in stack.state_dict().items() if key.startswith(places)}
    if own.keys() != {key for key in given if key.startswith(places)}:
        learned = {key: value for key, value in given.items() if not key.startswith(places)}
        given = learned | own
        _logger.info("%s has other dynamics: physical parameters keep their initial values", path)
    apart = _predictors_differ(content["provenance"]["config"], config) if config else ""
    _load(stack, given, path, apart)


def _predictors_differ(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """The settings of the predictor that differ, " (predictor.components 16 there, 25 here)"."""
    there, here = ({"predictor": each["stack"].get("predictor")} for each in (before, now))
    told = [
        f"{place} {first} there, {second} here" for place, first, second in differences(there, here)
    ]
    return f" ({'; '.join(told)})" if told else ""


def _load(stack: DiffStackMMV, weights: Mapping[str, Tensor], path: Path, apart: str = "") -> None:
    """Load weights that have to fit the stack completely; `apart` tells why they may not."""
    lost = [name for name, value in weights.items() if bool(torch.isnan(value).any())]
    require(not lost, "checkpoint", "hold no NaN", ", ".join(lost[:3]), f"in {path}", _REMEDY)
    try:
        stack.load_state_dict(weights)
    except RuntimeError as mismatch:
        faults = [line.strip().rstrip(".") for line in str(mismatch).splitlines()[1:]]
        more = f", and {len(faults) - 1} more like it" if len(faults) > 1 else ""
        told = f"{faults[0]}{more}{apart}"
        raise ValueError(
            message(
                "checkpoint",
                "fit the architecture of the stack",
                told,
                f"in {path}",
                "Build the stack with the configuration it was trained with, or train again.",
            )
        ) from mismatch


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint of this package on the CPU, without running code stored in it.

    Raises:
        ValueError: The file is missing, broken, or of another program.
    """
    content = read_plain(path, _REMEDY)
    config = _within(_within(content, "provenance"), "config")
    weights = _within(content, "state_dict")
    whole = isinstance(_within(config, "stack"), Mapping) and isinstance(weights, Mapping)
    plain = whole and all(isinstance(value, Tensor) for value in weights.values())
    found = "none" if config is None else "another"
    require(plain, "checkpoint", "hold its configuration and weights", found, f"in {path}", _REMEDY)
    return content


def learned_from(path: Path | str) -> dict[str, list[str]]:
    """Names of the recordings a checkpoint and those it was started from learned from.

    Args:
        path: The checkpoint, or the name of a shipped one.

    Returns:
        Scenes by the name of their data set; none where a checkpoint of before does not tell.

    Raises:
        ValueError: The file is missing, broken, or of another program.
    """
    told = read_checkpoint(checkpoint_path(path))["provenance"].get("data")
    told = told if isinstance(told, Mapping) else {}
    return {str(name): scenes for name, scenes in told.items() if isinstance(scenes, list)}


def write_lean(source: Path, target: Path) -> None:
    """Write a checkpoint with nothing but its weights and what tells how to build the stack.

    The state of the optimizer, of schedules and callbacks is left out, and so are paths of the
    machine it was trained on. Such a file can be evaluated and started from, not continued.

    Args:
        source: A checkpoint that scripts/train.py wrote.
        target: The file to write.

    Raises:
        ValueError: The source is missing, broken, or of another program.
    """
    content = read_checkpoint(source)
    provenance = content["provenance"]
    kept = {name: provenance["config"][name] for name in BUILT_FROM}
    lean = {"state_dict": content["state_dict"], "provenance": provenance | {"config": kept}}
    target.parent.mkdir(parents=True, exist_ok=True)
    with replacing(target) as unfinished:
        torch.save(lean, unfinished)


def _within(content: Any, key: str) -> Any:
    return content.get(key) if isinstance(content, Mapping) else None
