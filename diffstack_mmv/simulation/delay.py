"""Planning from where the vehicle will be when a command acts."""

import math

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_between
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.geometry import rotate
from diffstack_mmv.simulation.observation import Observation
from diffstack_mmv.types import Forecast, Motion, map_tensors


class DelayCompensation:
    """Rolls the observation forward over a known delay, under the command that is still acting.

    A command acts only after the delay; until then the one before it does. A plan that starts from
    the observed state therefore starts too early. The delay is at most one decision long.

    Args:
        model: The model of the controller, with the delay as its step.
        decision_s: Time between two decisions.

    Raises:
        ValueError: The delay is longer than a decision.
    """

    def __init__(self, model: DynamicsModel, decision_s: float = 0.25) -> None:
        require_between("delay", model.dt_s, 0, decision_s, remedy="Decide less often.")
        self.model = model

    def observation(self, observation: Observation, acting: Float[Tensor, "b m"]) -> Observation:
        """What will be observed after the delay; the pedestrians walk on as they do.

        Args:
            observation: The present, `b`.
            acting: The control under way, in the units of the model.
        """
        like = self.model.bounds.lower
        motion = Motion(*(field.to(like) for field in observation.motion))
        state = self.model.initial_state(motion)
        ahead = self.model.motion(self.model(state, acting.to(like)), acting.to(like))
        walked = self.model.dt_s * observation.pedestrian_velocity
        later = map_tensors(lambda new, old: new.to(old), ahead, observation.motion)
        return observation._replace(
            motion=later,
            velocity=rotate(later.velocity, later.heading),
            pedestrian_position=observation.pedestrian_position + walked,
        )

    def more_steps(self, step_s: float) -> int:
        """How many steps of `step_s` a forecast has to reach further than the plan."""
        return math.ceil(self.model.dt_s / step_s - 1e-9)

    def forecast(self, forecast: Forecast, step_s: float) -> Forecast:
        """A forecast seen from after the delay, shorter by `more_steps`.

        Args:
            forecast: In steps of `step_s`, which need not be those of the decisions.
            step_s: Time between two of its positions.
        """
        more, mean = self.more_steps(step_s), forecast.mean
        share = self.model.dt_s / step_s - (more - 1)
        path = mean[..., more - 1 :, :]
        later = path[..., :-1, :] + share * path.diff(dim=-2)
        return Forecast(forecast.log_weight, later, forecast.scale_tril[..., more:, :, :])
