"""Which physical parameters a training moves, and how fast."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor, nn

from diffstack_mmv.checks import require, require_positive


@runtime_checkable
class PhysicalModel(Protocol):
    """What is asked of a dynamics model here."""

    def physical_parameters(self) -> dict[str, Tensor]:
        """Values by name."""
        ...

    def get_submodule(self, target: str) -> nn.Module:
        """The module that holds the parameter of this name."""
        ...


@dataclass(frozen=True)
class PhysicsLearning:
    """Physical parameters as a group of their own in the optimizer, or frozen at their priors.

    Tracks without measured controls hardly inform them: what identification calls not identifiable
    would only drift within its range to wherever the networks are wrong.

    Attributes:
        rate: Learning rate of physical parameters as a multiple of that of all others.
        learned: Names of the parameters that are learned, e.g. "wheelbase"; None takes all that
            the vehicle allows, an empty list none.

    Raises:
        ValueError: The rate is not positive.
    """

    rate: float = 0.1
    learned: Sequence[str] | None = None

    def __post_init__(self) -> None:
        require_positive("physics.rate", self.rate)

    def freeze(self, dynamics: PhysicalModel) -> None:
        """Stop the gradient of whatever is not learned.

        Raises:
            ValueError: A name is none of a physical parameter of the model.
        """
        if self.learned is None:
            return
        known = list(dynamics.physical_parameters())
        for name in self.learned:
            place = f"of {type(dynamics).__name__}"
            require(name in known, "physics.learned", f"be among {known}", name, place)
        for name in known:
            if name not in self.learned:
                dynamics.get_submodule(name).requires_grad_(False)

    def require_learnable(self, dynamics: PhysicalModel) -> None:
        """Refuse to learn what the vehicle holds constant: it would stay so in silence.

        Raises:
            ValueError: Its file does not say that the parameter is learned.
        """
        for name in self.learned or ():
            moves = any(each.requires_grad for each in dynamics.get_submodule(name).parameters())
            wanted, place = "be what the vehicle lets learn", f"of {type(dynamics).__name__}"
            remedy = "Set `learn: true` in its file."
            require(moves, "physics.learned", wanted, name, place, remedy)

    def optimizer(
        self,
        make: Callable[..., torch.optim.Optimizer],
        module: nn.Module,
        dynamics: PhysicalModel,
    ) -> torch.optim.Optimizer:
        """Build the optimizer of a module with the learned physical parameters in their own group.

        Args:
            make: Makes an optimizer from `params`.
            module: Everything that is trained.
            dynamics: The model in it.
        """
        physical = {
            id(parameter)
            for name in dynamics.physical_parameters()
            for parameter in dynamics.get_submodule(name).parameters()
        }
        learned = [each for each in module.parameters() if each.requires_grad]
        networks = [each for each in learned if id(each) not in physical]
        own = [each for each in learned if id(each) in physical]
        groups: list[dict[str, Any]] = [{"params": networks, "name": "networks"}]
        if own:
            groups.append({"params": own, "name": "physics"})
        made = make(params=groups)
        for group in made.param_groups[1:]:
            group["lr"] *= self.rate
        return made
