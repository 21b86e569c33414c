"""A controller whose decisions a trained network makes."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import torch

from diffstack_mmv.checks import require
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.simulation.assembly import Actuate
from diffstack_mmv.simulation.decisions import Decided
from diffstack_mmv.simulation.observation import Observation
from diffstack_mmv.simulation.views import EgoView


@dataclass
class LearnedPolicy:
    """Drives by a policy that `scripts/train_policy.py` has trained; it remembers nothing.

    Attributes:
        path: The policy, a file of stable-baselines3 (extra `rl`).
        dynamics: Model of the vehicle, for the bounds of its controls.
        actuate: Turns controls of the model into those of the robot.
        view: What the policy is shown, as in its training.

    Raises:
        ValueError: There is no policy.
    """

    path: str | Path | None
    dynamics: DynamicsModel
    actuate: Actuate
    view: EgoView = field(default_factory=EgoView)

    def __post_init__(self) -> None:
        """Ask for a policy."""
        remedy = "Train one: dmmv-train-policy, then policy=DIR/policy.zip."
        require(self.path is not None, "policy", "be given", self.path, "", remedy)

    @cached_property
    def _policy(self) -> Any:
        """The policy, read at the first decision."""
        from diffstack_mmv.simulation.reinforcement import load_policy

        return load_policy(Path(str(self.path)))

    def init(self, observation: Observation) -> None:
        """Nothing to remember."""
        return

    def act(self, state: None, observation: Observation) -> Decided:
        """The mean of the policy, in the units of the robot."""
        share, _ = self._policy.predict(self.view(observation), deterministic=True)
        share = torch.as_tensor(share, dtype=torch.float64).clamp(-1, 1)
        lower, upper = map(
            share.new_tensor, (self.dynamics.control_lower, self.dynamics.control_upper)
        )
        return Decided(self.actuate(lower + 0.5 * (share + 1) * (upper - lower)), None)
