"""Finished parts of a study on disk, so that a study that was interrupted goes on where it was."""

import hashlib
import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from diffstack_mmv.identification.measured.instruments import Gaussian, InstrumentPriors
from dmmv_conventions.archives import opened_arrays
from dmmv_conventions.disk import replacing

logger = logging.getLogger(__name__)

Part = dict[str, Tensor]

SECONDS = "seconds"


@dataclass(frozen=True)
class FinishedParts:
    """Computes parts, or reads them where they are finished.

    A part is found again under its name and the key of what it was made of. A file is written
    beside its place and then moved there, so that it is whole or missing; a damaged one is made
    anew.

    Attributes:
        folder: Where the parts are; nothing is kept by default.
        key: Digest of data and settings, those of `keyed` included.
    """

    folder: str | Path | None = None
    key: str = ""

    def keyed(self, *made_of: object) -> "FinishedParts":
        """Parts that are made of data (tensors) and settings (whose text counts) as well."""
        digest = hashlib.sha256(self.key.encode())
        for each in made_of:
            array = each.numpy().tobytes() if isinstance(each, Tensor) else repr(each).encode()
            digest.update(array)
        return FinishedParts(self.folder, digest.hexdigest()[:12])

    def __call__(self, name: str, make: Callable[[], Mapping[str, Tensor]]) -> Part:
        """A part by its name, with the processor seconds that it took."""
        if self.folder is None:
            return _timed(make)
        path = Path(self.folder) / f"{name}-{self.key}.npz"
        if part := _read(path):
            return part
        part = _timed(make)
        with replacing(path) as unfinished, unfinished.open("wb") as stream:
            # the types of numpy take names of arrays for its own arguments
            np.savez(stream, **{key: value.numpy() for key, value in part.items()})  # pyright: ignore[reportArgumentType]
        return part


def _read(path: Path) -> Part:
    """A finished part, empty where there is none or its file is damaged."""
    if not path.is_file():
        return {}
    try:
        with opened_arrays(path) as arrays:
            return {key: torch.from_numpy(arrays[key]) for key in arrays.files}
    except ValueError as damaged:
        logger.warning("A part is computed again: %s", damaged)
        return {}


def _timed(make: Callable[[], Mapping[str, Tensor]]) -> Part:
    begin = time.process_time()
    part = dict(make())
    return part | {SECONDS: torch.tensor(time.process_time() - begin, dtype=torch.float64)}


def priors_as_tensor(priors: InstrumentPriors) -> Tensor:
    """Mean and deviation of each of n fields, the share of coasting windows last: (2 n + 1,)."""
    *pairs, share = astuple(priors)
    return torch.tensor([*(value for pair in pairs for value in pair), share], dtype=torch.float64)


def priors_from_tensor(values: Tensor) -> InstrumentPriors:
    """The inverse of `priors_as_tensor`: from shape (2 n + 1,)."""
    *pairs, share = values.tolist()
    names = [each.name for each in fields(InstrumentPriors)][:-1]
    gaussians = dict(zip(names, map(Gaussian, pairs[::2], pairs[1::2]), strict=True))
    return replace(InstrumentPriors(coasting_share=share), **gaussians)
