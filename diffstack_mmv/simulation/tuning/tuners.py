"""Ways to better the weights of a cost: along the gradient, or without any."""

import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require, require_at_least, require_positive
from dmmv_conventions.extras import needs

LOGGER = logging.getLogger(__name__)
Loss = Callable[[], Float[Tensor, ""]]


@runtime_checkable
class LearnableWeights(Protocol):
    """Positive weights by name, of which some are learned by their logarithms."""

    learned: list[str]

    def learnable(self) -> torch.nn.Parameter:
        """Logarithms of the `learned` weights, one of each.

        A method, since Python 3.12 looks for attributes of a protocol where a module does not keep
        its parameters.
        """
        ...

    def weights(self) -> Mapping[str, Tensor | float]:
        """Present weight of every term."""
        ...


class Round(NamedTuple):
    """One try of a tuner."""

    weights: dict[str, float]
    loss: float
    seconds: float  # processor time since the beginning


def best(rounds: Sequence[Round]) -> Round:
    """The try with the smallest loss; one that is no number is none."""
    return min(rounds, key=lambda each: math.inf if math.isnan(each.loss) else each.loss)


@dataclass(frozen=True)
class GradientTuner:
    """Adam on the logarithms of the weights.

    Attributes:
        rounds: Losses that are evaluated.
        learning_rate: Of the logarithms; it falls to zero over the rounds.
        largest: Norm to which gradients are clipped; one contact must not decide.

    Raises:
        ValueError: A number is not positive.
    """

    rounds: int = 30
    learning_rate: float = 0.1
    largest: float = 1.0

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_at_least("rounds", self.rounds, 1)
        require_positive("learning_rate", self.learning_rate)
        require_positive("largest", self.largest)

    def __call__(self, cost: LearnableWeights, loss: Loss) -> Iterator[Round]:
        """Change the weights of a cost round by round.

        Args:
            cost: Its `learnable` logarithms change.
            loss: Of the present weights, with a gradient.

        Yields:
            Weights and loss before each change.
        """
        log_weight = cost.learnable()
        optimizer = torch.optim.Adam([log_weight], lr=self.learning_rate)
        began = time.process_time()
        for number in range(self.rounds):
            optimizer.param_groups[0]["lr"] = self.learning_rate * (1 - number / self.rounds)
            weights, value = weights_of(cost), loss()
            optimizer.zero_grad()
            value.backward()
            torch.nn.utils.clip_grad_norm_([log_weight], self.largest)
            yield Round(weights, float(value.detach()), time.process_time() - began)
            if log_weight.grad is not None and bool(log_weight.grad.isfinite().all()):
                optimizer.step()
            else:
                LOGGER.warning("The gradient is not finite: the weights stay for a round.")


@dataclass(frozen=True)
class OptunaTuner:
    """Optuna's tree-structured Parzen estimator on the same logarithms (extra `tune`).

    Attributes:
        rounds: Losses that are evaluated, the initial weights first.
        factor: Each logarithm is searched within ± log of this around its initial value.
        seed: Of the draws.

    Raises:
        ValueError: There is no round, or the factor is infinite or not above one.
    """

    rounds: int = 30
    factor: float = 10.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_at_least("rounds", self.rounds, 1)
        searched = 1 < self.factor < math.inf
        require(searched, "factor", "be finite and above 1", self.factor)

    def __call__(self, cost: LearnableWeights, loss: Loss) -> Iterator[Round]:
        """Try weights of a cost round by round.

        Args:
            cost: Its `learnable` logarithms change.
            loss: Of the present weights.

        Yields:
            Weights and loss of each trial.
        """
        with needs("tune", "tuning without gradients"):
            import optuna  # pyright: ignore[reportMissingImports]
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=self.seed))
        log_weight = cost.learnable()
        initial = log_weight.detach().clone()
        study.enqueue_trial(dict.fromkeys(cost.learned, 0.0))
        reach, began = math.log(self.factor), time.process_time()
        for _ in range(self.rounds):
            trial = study.ask()
            shift = [trial.suggest_float(name, -reach, reach) for name in cost.learned]
            with torch.no_grad():
                log_weight.copy_(initial + initial.new_tensor(shift))
                value = float(loss())
            study.tell(trial, value)
            yield Round(weights_of(cost), value, time.process_time() - began)


def weights_of(cost: LearnableWeights) -> dict[str, float]:
    """Present weights of a cost as numbers."""
    return {
        name: float(torch.as_tensor(weight).detach()) for name, weight in cost.weights().items()
    }
