"""What a controller is: it chooses the actions of the robots of all episodes at once."""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import message
from diffstack_mmv.simulation.observation import Observation
from diffstack_mmv.types import map_tensors


class Decided(NamedTuple):
    """An action, and what the controller has to remember for its next decision."""

    action: Float[Tensor, "*b m"]
    state: Any


@runtime_checkable
class Controller(Protocol):
    """Chooses the actions of the robots of all episodes at once.

    A controller holds settings only; what it remembers of its episodes is a record of its own that
    goes in and comes out. A class with a true attribute `massless` drives the massless robot of the
    original benchmark.
    """

    def init(self, observation: Observation) -> Any:
        """State at the start of episodes."""
        ...

    def act(self, state: Any, observation: Observation) -> Decided:
        """Action in the units of the robot, and the state for the next decision."""
        ...


def require_controller(controller: object) -> None:
    """Refuse what is no controller.

    Raises:
        TypeError: It lacks a method.
    """
    if not isinstance(controller, Controller) or isinstance(controller, type):
        found = getattr(controller, "__name__", type(controller).__name__)
        remedy = "Give an object of a class that has both methods."
        raise TypeError(message("controller", "have init and act", found, "", remedy))


def decide(controller: Controller, state: Any, observation: Observation) -> Decided:
    """What a controller decides.

    Raises:
        TypeError: It answers with something else than an action and a state.
    """
    answer = controller.act(state, observation)
    if not isinstance(answer, tuple) or len(answer) != len(Decided._fields):
        found = type(answer).__name__
        wanted = "return an action and the state for the next decision"
        remedy = "Write `return Decided(action, state)`."
        where = f"from {type(controller).__name__}.act"
        raise TypeError(message("controller", wanted, found, where, remedy))
    return Decided(*answer)


def batched(observation: Observation) -> Observation:
    """The observation with a leading dimension, of one where a single episode has none."""
    if observation.time.dim() > 0:
        return observation
    return map_tensors(lambda entry: entry.unsqueeze(0), observation)


def unbatched(controller: Controller, state: Any, observation: Observation) -> Decided:
    """Decide for a single episode as for a batch of one, whose state has that leading dimension."""
    action, after = decide(controller, state, batched(observation))
    return Decided(action.squeeze(0), after)


def continued(controls: Float[Tensor, "*b T m"], share: float) -> Float[Tensor, "*b T m"]:
    """A plan after a share of one of its steps, or several; its last control goes on."""
    steps = controls.shape[-2]
    ahead = torch.arange(steps, device=controls.device) + share + 1e-6
    return controls[..., ahead.floor().long().clamp(max=steps - 1), :]


def diagnosis_of(controller: Controller, state: Any) -> dict[str, Float[Tensor, " E"]]:
    """What a controller tells of its episodes; nothing if it has no `diagnosis`."""
    diagnose = getattr(controller, "diagnosis", None)
    return {} if diagnose is None else diagnose(state)


def thoughts_of(controller: Controller, state: Any) -> dict[str, Float[np.ndarray, "E S *d"]]:
    """What a controller expected and planned; nothing if it has no `thoughts`."""
    think = getattr(controller, "thoughts", None)
    return {} if think is None else think(state)
