"""What a training minimises."""

from collections.abc import Callable
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require, require_at_least
from diffstack_mmv.metrics import mean_square_displacement
from diffstack_mmv.types import Tracks

PathError = Callable[[Float[Tensor, "*b T 2"], Tracks], Float[Tensor, "*b"]]


@dataclass(frozen=True)
class LossWeights:
    """Weights of the parts of the training loss, dimensionless, and what L_ctrl is.

    L = prediction · L_pred + planning · (CE + hindsight · C) + control · L_ctrl

    Raises:
        ValueError: A weight is negative, or no part of the loss has one.
    """

    prediction: float = 1.0
    planning: float = 1.0
    hindsight: float = 0.01
    control: float = 1.0
    imitation: PathError = mean_square_displacement

    def __post_init__(self) -> None:
        weights = {
            "loss.prediction": self.prediction,
            "loss.planning": self.planning,
            "loss.control": self.control,
        }
        for name, weight in weights.items():
            require_at_least(name, weight, 0.0)
        require_at_least("loss.hindsight", self.hindsight, 0.0)
        remedy = "Give loss.prediction, loss.planning or loss.control."
        some = any(weight > 0 for weight in weights.values())
        require(some, "loss", "have a positive weight", list(weights.values()), "", remedy)

    @property
    def plans(self) -> bool:
        """Whether any part of the loss is one of a plan."""
        return self.planning > 0 or self.control > 0
