"""Moments of roll-outs in generated libraries, for predictors, which know nothing of solvers."""

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics import DynamicsModel


def generated_moments(
    dynamics: DynamicsModel,
    start: Float[Tensor, "N n"],
    covariance: Float[Tensor, "N n n"],
    controls: Float[Tensor, "N T m"],
    scale: Float[Tensor, "N T m m"],
) -> tuple[Float[Tensor, "N T 2"], Float[Tensor, "N T 2 2"]] | None:
    """Mean and covariance of positions under Gaussian controls, None where there is no library.

    On the host, also for tensors of a GPU, where there is a C++ compiler; a library is built at the
    first use of a model, which takes seconds (DiffGM3: 20), and kept on disk.

    Args:
        dynamics: The model.
        start: Mean of the first state.
        covariance: Of the first state.
        controls: Mean controls.
        scale: Cholesky factors of their covariances.
    """
    # imported here: a stack that runs eagerly does without
    from diffstack_mmv.control.native.moments import moments

    return moments(dynamics, start, covariance, controls, scale)
