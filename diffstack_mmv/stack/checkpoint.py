"""A trained stack from its checkpoint alone."""

import pickle
from pathlib import Path
from typing import Any, NamedTuple

import torch
from hydra.utils import instantiate

from diffstack_mmv.checks import message
from diffstack_mmv.stack.module import DiffStackMMV

_REMEDY = "Give the path of a checkpoint that scripts/train.py wrote."


class TrainedStack(NamedTuple):
    """A stack in evaluation mode, and the configuration it was trained with."""

    stack: DiffStackMMV
    config: dict[str, Any]


def load_stack(path: Path, device: torch.device | str = "cpu") -> TrainedStack:
    """Build the stack that a checkpoint describes, and load its weights.

    Raises:
        ValueError: The file is missing, broken, of another program, or of another architecture
            than this version builds.
    """
    config = read_checkpoint(path)["provenance"]["config"]
    stack = instantiate(config["stack"])
    load_weights(stack, path)
    return TrainedStack(stack.eval().to(device), config)


def load_weights(stack: DiffStackMMV, path: Path) -> None:
    """Start a stack from the weights of a checkpoint.

    Raises:
        ValueError: The file is missing, broken, of another program, or of a stack of another
            architecture.
    """
    content = read_checkpoint(path)
    try:
        stack.load_state_dict(content["state_dict"])
    except RuntimeError as mismatch:
        told = "; ".join(line.strip() for line in str(mismatch).splitlines()[1:4])
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
    if not path.is_file():
        raise ValueError(message("checkpoint", "be an existing file", repr(str(path)), "", _REMEDY))
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except (RuntimeError, EOFError, OSError, pickle.UnpicklingError) as broken:
        told = str(broken).splitlines()[0]
        raise ValueError(
            message("checkpoint", "be readable", told, f"in {path}", _REMEDY)
        ) from broken
    if not isinstance(content, dict) or "provenance" not in content:
        raise ValueError(
            message("checkpoint", "hold its configuration", "none", f"in {path}", _REMEDY)
        )
    return content
