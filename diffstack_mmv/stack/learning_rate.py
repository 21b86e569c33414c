"""Learning rates for training with several processes."""

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import distributed, nn

from diffstack_mmv.checks import require_between, require_positive


class ScaledByProcesses:
    """An optimizer whose learning rate grows with the number of processes.

    Each process adds its batch to the step. With exponent 1 this is the linear rule for SGD, with
    1/2 the square-root rule for Adam and its relatives.

    Source:
        Goyal et al., Accurate, Large Minibatch SGD (2017); Malladi et al., On the SDEs and Scaling
        Rules for Adaptive Gradient Algorithms (NeurIPS 2022).

    Args:
        optimizer: Makes the optimizer from `params` and `lr`.
        lr: Learning rate of a single process.
        exponent: Power of the number of processes.

    Raises:
        ValueError: The rate is not positive, or the exponent lies outside [0, 1].
    """

    def __init__(
        self, optimizer: Callable[..., torch.optim.Optimizer], lr: float, exponent: float = 0.5
    ) -> None:
        require_positive("lr", lr)
        require_between("exponent", exponent, 0.0, 1.0)
        self.optimizer = optimizer
        self.lr = lr
        self.exponent = exponent

    def __call__(self, params: Iterable[nn.Parameter]) -> Any:
        """The optimizer, for as many processes as train now."""
        processes = distributed.get_world_size() if distributed.is_initialized() else 1
        return self.optimizer(params=params, lr=self.lr * processes**self.exponent)
