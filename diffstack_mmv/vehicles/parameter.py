"""Bounded, learnable physical parameters and exact constants."""

import math
from collections.abc import Callable, Sequence
from typing import Any, Self

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.vehicles.quantity import Numbers, ParameterSpec


class ExactBuffers(nn.Module):
    """Module whose constants keep double precision when it changes its type.

    Constants are stored as Python floats and become tensors anew whenever the module moves or
    changes type; a model built in float32 and then turned to float64 is exact, and no call copies
    from host to device.
    """

    def __init__(self) -> None:
        super().__init__()
        self._exact: dict[str, Any] = {}

    def register_exact(self, name: str, values: float | Sequence[Any]) -> None:
        """Register a constant under `self.name`, outside of the state dictionary."""
        self._exact[name] = values
        self.register_buffer(
            name, torch.tensor(values, dtype=torch.get_default_dtype()), persistent=False
        )

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        super()._apply(fn, recurse)
        for name, values in self._exact.items():
            moved = self.get_buffer(name)
            if moved.is_floating_point() and not moved.is_meta:
                self.register_buffer(
                    name,
                    torch.tensor(values, dtype=moved.dtype, device=moved.device),
                    persistent=False,
                )
        return self


class SoftClamped(ExactBuffers):
    """A physical parameter that stays inside its range: middle + half_range · tanh(raw + offset).

    `raw` is the constant that makes offset 0 the prior; `offset` is what training moves. A range
    of zero width gives exactly the constant.

    Args:
        spec: Prior, range, unit, and whether it is learned.
    """

    def __init__(self, spec: ParameterSpec) -> None:
        super().__init__()
        self.spec = spec
        columns: dict[str, list[float]] = {"middle": [], "half_range": [], "raw": []}
        for initial, low, high in spec.entries():
            mid, half = 0.5 * (low + high), 0.5 * (high - low)
            columns["middle"].append(mid)
            columns["half_range"].append(half)
            columns["raw"].append(math.atanh((initial - mid) / half) if half > 0 else 0.0)
        for name, column in columns.items():
            self.register_exact(name, column if spec.length else column[0])
        shape = (spec.length,) if spec.length and not spec.tied else ()
        self.offset = nn.Parameter(torch.zeros(shape), requires_grad=spec.learn)

    @property
    def unit(self) -> str:
        """Unit of the value."""
        return self.spec.unit

    @property
    def low(self) -> Numbers:
        """Lower end of the range."""
        return self.spec.low

    @property
    def high(self) -> Numbers:
        """Upper end of the range."""
        return self.spec.high

    def forward(self) -> Float[Tensor, "*wheels"]:
        """Value in its physical unit, shape () or (wheels,)."""
        return torch.addcmul(
            self.get_buffer("middle"),
            self.get_buffer("half_range"),
            torch.tanh(self.get_buffer("raw") + self.offset),
        )
