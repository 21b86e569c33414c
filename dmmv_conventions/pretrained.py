"""Names of the checkpoints that the package ships."""

from os import PathLike
from pathlib import Path

from dmmv_conventions.checks import require, require_one_of

PRETRAINED = "pretrained"
"""What such a name begins with: pretrained, pretrained/gm3."""
DEFAULT = "kbm"
FOLDER = Path(__file__).resolve().parents[1] / "diffstack_mmv" / "stack" / PRETRAINED


def checkpoint_path(checkpoint: str | Path) -> Path:
    """Path of a checkpoint, given as a path or as the name of one that the package ships.

    `pretrained` is the one of DiffKBM, `pretrained/NAME` that of the dynamics NAME; a file of that
    name goes first.

    Raises:
        ValueError: No checkpoint of that name is shipped, or it is neither path nor name.
    """
    named = isinstance(checkpoint, (str, PathLike))
    require(named, "checkpoint", "be a path, or a name such as pretrained", repr(checkpoint))
    name, _, dynamics = str(checkpoint).partition("/")
    if name != PRETRAINED or Path(checkpoint).exists():
        return Path(checkpoint)
    shipped = tuple(sorted(path.stem for path in FOLDER.glob("*.ckpt")))
    require_one_of("checkpoint", dynamics or DEFAULT, shipped)
    return FOLDER / f"{dynamics or DEFAULT}.ckpt"
