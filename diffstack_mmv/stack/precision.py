"""Mixed precision of the predictor: its layers in half precision, everything else in float32."""

from typing import Any

import torch
from torch import Tensor, nn

from diffstack_mmv.checks import require

LAYERS = (nn.Linear, nn.GRU, nn.GRUCell, nn.LSTM, nn.LSTMCell)
"""What is worth half precision: products with learned matrices."""


class MixedPrecision:
    """Runs the layers of a predictor in a shorter floating-point type.

    What lies between them stays in float32: dynamics, covariances and likelihoods lose their
    meaning with eight bits of mantissa. Planner and solver are not touched at all. On a CPU this
    saves nothing; on a GPU with matrix units it pays off for wide layers and large batches.

    Args:
        dtype: Name of the type, "bfloat16" or "float16".

    Raises:
        ValueError: It is none of the two.
    """

    def __init__(self, dtype: str = "bfloat16") -> None:
        known = {"bfloat16": torch.bfloat16, "float16": torch.float16}
        require(dtype in known, "dtype", f"be one of {', '.join(known)}", repr(dtype))
        self.dtype = known[dtype]

    def apply(self, predictor: nn.Module) -> None:
        """Have all layers of a predictor work in this precision; their parameters stay float32."""
        for layer in predictor.modules():
            if isinstance(layer, LAYERS):
                layer.forward = _Autocast(layer.forward, self.dtype)


class _Autocast:
    """Forward of a layer in half precision with results in float32.

    An object, not a closure: a copy of the layer, which averaged weights need, gets its own.
    """

    def __init__(self, forward: Any, dtype: torch.dtype) -> None:
        self.forward = forward
        self.dtype = dtype

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        device = next(each.device for each in arguments if isinstance(each, Tensor)).type
        with torch.autocast(device, self.dtype):
            result = self.forward(*arguments, **options)
        return _as_float32(result)


def _as_float32(value: Any) -> Any:
    if isinstance(value, Tensor):
        return value.float()
    return tuple(_as_float32(each) for each in value)
