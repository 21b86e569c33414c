"""Mixed precision of the predictor: its layers in half precision, everything else in float32."""

from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from diffstack_mmv.checks import require

LAYERS = (nn.Linear, nn.GRU, nn.GRUCell, nn.LSTM, nn.LSTMCell)
"""What is worth half precision: products with learned matrices."""


class MixedPrecision:
    """Runs the layers of a predictor in a shorter floating-point type.

    What lies between them stays in float32: dynamics, covariances and likelihoods lose their
    meaning with eight bits of mantissa. Planner and solver are not touched at all. On a CPU this
    saves nothing; on a GPU with matrix units it pays off for wide layers and large batches.

    A float16 has the range 6e-8 to 65504, which gradients leave on both sides. Its linear layers
    therefore bring each gradient to the order of one before it is shortened, and what follows from
    it back; there is no scale of the loss to be found, and no step is left out. Its recurrent
    layers stay in float32.

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
            if self.dtype == torch.float16:
                if isinstance(layer, nn.Linear):
                    layer.forward = _Half(layer.forward)  # pyright: ignore[reportAttributeAccessIssue]
            elif isinstance(layer, LAYERS):
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


class _Half:
    """Forward of a linear layer in float16 with results in float32; an object, see `_Autocast`."""

    def __init__(self, forward: Any) -> None:
        self.forward = forward

    def __call__(self, inputs: Tensor) -> Tensor:
        layer = self.forward.__self__
        with torch.autocast(inputs.device.type, enabled=False):
            result: Tensor = _HalfLinear.apply(inputs, layer.weight, layer.bias)  # type: ignore[no-untyped-call]
        return result


class _HalfLinear(torch.autograd.Function):
    """A linear layer in float16 whose backward pass stays within its range."""

    @staticmethod
    def forward(ctx: Any, inputs: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        short = inputs.half(), weight.half()
        ctx.save_for_backward(*short)
        found = nn.functional.linear(*short).float()
        return found if bias is None else found + bias

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        inputs, weight = ctx.saved_tensors
        rows = grad.flatten(0, -2)
        # the largest becomes one over the root of the rows, since sums over them must fit as well
        largest = rows.abs().amax() if rows.numel() else rows.new_ones(())
        scale = torch.exp2(-torch.ceil(torch.log2(largest * max(len(rows), 1) ** 0.5)))
        scale = torch.where(largest > 0, scale, torch.ones_like(scale))
        short = (rows * scale).half()
        by_inputs = (short @ weight).float() / scale
        by_weight = (short.mT @ inputs.flatten(0, -2)).float() / scale
        by_bias = rows.sum(0) if ctx.needs_input_grad[2] else None
        return by_inputs.reshape(inputs.shape), by_weight, by_bias
