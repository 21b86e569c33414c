"""The discrete latent variable: which of K ways of going on."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.prediction.trajectron.encoder import perceptron

HIDDEN = 32
"""Units of the hidden layer of prior and posterior."""


class Latent(nn.Module):
    """Prior p(z|x) and posterior q(z|x, y) over K components.

    Args:
        context_size: Size of the encoding of x, the present scene.
        future_size: Size of the encoding of y, the future.
        components: K.

    Raises:
        ValueError: There is no component.
    """

    def __init__(self, context_size: int, future_size: int, components: int) -> None:
        super().__init__()
        require_at_least("components", components, 1)
        self.prior = perceptron([context_size, HIDDEN, components])
        self.posterior = perceptron([context_size + future_size, HIDDEN, components])

    def log_prior(self, context: Float[Tensor, "R c"]) -> Float[Tensor, "R K"]:
        """Return log p(z|x)."""
        return self.prior(context).log_softmax(-1)

    def log_posterior(
        self, context: Float[Tensor, "R c"], future: Float[Tensor, "R f"]
    ) -> Float[Tensor, "R K"]:
        """Return log q(z|x, y)."""
        return self.posterior(torch.cat([context, future], -1)).log_softmax(-1)


def divergence(log_q: Float[Tensor, "*b K"], log_p: Float[Tensor, "*b K"]) -> Float[Tensor, "*b"]:
    """KL(q || p) in nats of two categorical distributions."""
    return (log_q.exp() * (log_q - log_p)).sum(-1)


@dataclass(frozen=True)
class Annealing:
    """Weight of the KL term over the steps of training.

    weight · sigmoid(4 (step - crossover) / crossover)

    Attributes:
        weight: Final weight.
        crossover_steps: Step at which half of it is reached.
        free_nats: Divergence that costs nothing.

    Raises:
        ValueError: A number is out of its range.
    """

    weight: float = 100.0
    crossover_steps: int = 400
    free_nats: float = 0.07

    def __post_init__(self) -> None:
        require_at_least("annealing.weight", self.weight, 0.0)
        require_positive("annealing.crossover_steps", self.crossover_steps)
        require_at_least("annealing.free_nats", self.free_nats, 0.0)

    def penalty(self, divergence: Float[Tensor, "*b"], step: Tensor) -> Float[Tensor, "*b"]:
        """Penalty in nats on a divergence at a step of training."""
        progress = torch.sigmoid(4 * (step - self.crossover_steps) / self.crossover_steps)
        return self.weight * progress * (divergence - self.free_nats).clamp_min(0)
