"""Planning from where the vehicle will be when a command acts."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_between
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.simulation.observation import Observation
from diffstack_mmv.types import Forecast, Motion


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
        self.share = model.dt_s / decision_s

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
        return observation._replace(
            motion=Motion(
                *(new.to(old) for new, old in zip(ahead, observation.motion, strict=True))
            ),
            pedestrian_position=observation.pedestrian_position + walked,
        )

    def forecast(self, forecast: Forecast, now: Float[Tensor, "b h 2"]) -> Forecast:
        """A forecast of one step more, seen from after the delay, a step shorter.

        Args:
            forecast: Of T + 1 decisions, `b h K T1`.
            now: Where everybody is at present in m.
        """
        mean, scale = forecast.mean, forecast.scale_tril
        start = now[..., None, None, :].expand_as(mean[..., :1, :])
        path = torch.cat([start.to(mean), mean], -2)[..., 1:, :]
        later = path[..., :-1, :] + self.share * path.diff(dim=-2)
        return Forecast(forecast.log_weight, later, scale[..., 1:, :, :])
