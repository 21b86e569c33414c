"""Driving by the model that has explained the motion best so far, e.g. the friction of the road."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffstack_mmv.checks import require, require_between, require_positive
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.simulation.assembly import SimulatedVehicle, controller_model
from diffstack_mmv.simulation.controller import DiffMPCController, DiffMPCState, merged
from diffstack_mmv.simulation.decisions import Decided, unbatched
from diffstack_mmv.simulation.observation import Observation
from diffstack_mmv.types import Motion

logger = logging.getLogger(__name__)

ARM_M = 0.5
"""An error of the yaw rate counts as that of the speed of a point so far from the centre."""


def models_by_friction(
    believed: SimulatedVehicle, actual: SimulatedVehicle, dt_s: float, frictions: Sequence[float]
) -> list[DynamicsModel]:
    """What a controller believes of the robot, once for each friction of its tyres.

    Args:
        believed: Vehicle and dynamics that the controller believes in.
        actual: The vehicle that drives, for its reference point.
        dt_s: Time for which a control is held.
        frictions: Friction coefficients of all tyres.

    Raises:
        ValueError: A friction is none, or the step does not fit.
    """
    each = (replace(believed, friction=friction) for friction in frictions)
    return [controller_model(vehicle, actual, dt_s) for vehicle in each]


class AdaptiveState(NamedTuple):
    """What an adaptive controller remembers, `b` episodes and `k` models."""

    inner: DiffMPCState
    before: Motion | None  # where the last decision was taken
    error: Float[Tensor, "b k"]  # (m/s)², discounted sum of the errors of each model
    chosen: Int[Tensor, " b"]


class AdaptiveController:
    """DiffMPC with several models of the vehicle; each episode drives by the one that fits it best.

    After every decision each model foretells the velocity and yaw rate that its command leads to;
    the squared errors are summed with older ones discounted. The first model is driven by until
    another one explains the motion better by more than a tolerance. A model that foretells the same
    as one before it, such as a bicycle without tyres with less friction, is left out.

    Args:
        controller: Decides; its own model is the first.
        models: The other models, with the same controls, e.g. with less friction. The step of all
            models is the time between two decisions, over which they are compared.
        discount: Weight of an error one decision later.
        tolerance_mps: A model replaces the first one if its error is smaller by the square of this.

    Raises:
        ValueError: The discount is outside of (0, 1], the tolerance not positive, or a model has
            another step.
    """

    def __init__(
        self,
        controller: DiffMPCController,
        models: Sequence[DynamicsModel],
        discount: float = 0.9,
        tolerance_mps: float = 0.1,
    ) -> None:
        require_between("discount", discount, 0, 1)
        require_positive("tolerance_mps", tolerance_mps)
        first = controller.planner.dynamics
        for model in (first, *models):
            needs = f"have the step of a decision, {controller.dt_s:g} s"
            fits = abs(model.dt_s - controller.dt_s) < 1e-9
            require(fits, "models", needs, f"{model.dt_s:g} s", "", "Set `model.dt_s`.")
        self.models = _different([first, *models])
        if len(self.models) == 1:
            logger.warning(
                "All models of the adaptive controller foretell the same: it drives as the plain "
                "one. Friction is felt by tyres alone, which dynamics=gm3 has."
            )
        others = (controller.with_model(model) for model in self.models[1:])
        self.controllers = [controller, *others]
        self.discount = discount
        self.tolerance_mps = tolerance_mps

    def init(self, observation: Observation) -> AdaptiveState:
        """State at the start of episodes: the first model, and no error yet."""
        inner = self.controllers[0].init(observation)
        error = inner.waited.new_zeros(len(inner.plan), len(self.models))
        chosen = torch.zeros(len(inner.plan), dtype=torch.long)
        return AdaptiveState(inner, None, error, chosen)

    def act(self, state: AdaptiveState, observation: Observation) -> Decided:
        """Action in the units of the robot, by the chosen model of each episode."""
        if observation.time.dim() == 0:
            return unbatched(self, state, observation)
        error = self._errors(state, observation)
        first = torch.arange(len(self.models)) == 0
        chosen = (error - self.tolerance_mps**2 * first.to(error)).argmin(-1)
        after, action, made = state.inner, observation.goal.new_zeros(0), []
        for number, controller in enumerate(self.controllers):
            keep = chosen == number
            mine = observation.running & keep
            if bool(mine.any()):
                own, known = controller.act(state.inner, observation._replace(running=mine))
                action = torch.where(keep[:, None], own, action) if len(action) else own
                after = _joined(after, known, keep)
                made.append(known.decisions[-1])
        if made:
            after = after._replace(decisions=(*after.decisions, merged(made)))
        return Decided(action, AdaptiveState(after, observation.motion, error, chosen))

    def _errors(self, state: AdaptiveState, observation: Observation) -> Float[Tensor, "b k"]:
        """Discounted errors of all models after the last command."""
        if state.before is None:
            return state.error
        like = self.models[0].bounds.lower
        before = Motion(*(field.to(like) for field in state.before))
        now = Motion(*(field.to(like) for field in observation.motion))
        command, errors = state.inner.plan[:, 0].to(like), []
        for model in self.models:
            told = model.motion(model(model.initial_state(before), command), command)
            turned = ARM_M * (told.yaw_rate - now.yaw_rate)
            errors.append((told.velocity - now.velocity).square().sum(-1) + turned.square())
        fresh = torch.stack(errors, -1).to(state.error)
        return torch.where(fresh.isfinite(), self.discount * state.error + fresh, torch.inf)

    def diagnosis(self, state: AdaptiveState) -> dict[str, Float[Tensor, " E"]]:
        """Per episode: what the controller tells of itself, and the number of the last model."""
        told = self.controllers[0].diagnosis(state.inner)
        return told | {"model": state.chosen.float()}

    def thoughts(self, state: AdaptiveState) -> dict[str, Float[np.ndarray, "E S *d"]]:
        """What was expected of each pedestrian, and planned by the model in use."""
        return self.controllers[0].thoughts(state.inner)


@torch.no_grad()
def _different(models: Sequence[DynamicsModel]) -> list[DynamicsModel]:
    """The models that foretell something else than all before them, at speeds and turns at random.

    What a model is like is told by no number alone: a friction is nothing to one without tyres.
    """
    lower, upper = models[0].bounds
    share = torch.rand(16, 2 + len(lower), generator=torch.Generator().manual_seed(0)).to(lower)
    place, command = torch.zeros_like(share[:, :2]), lower + (upper - lower) * share[:, 2:]
    forward = torch.stack([5 * share[:, 0], place[:, 0]], -1)
    before = Motion(place, place[:, 0], forward, 4 * share[:, 1] - 2)
    kept: list[DynamicsModel] = []
    told: list[Tensor] = []
    for model in models:
        state = model.initial_state(before)
        after = torch.cat([state, model(state, command)], -1)
        if not any(torch.equal(after, other) for other in told):
            kept.append(model)
            told.append(after)
    return kept


def _joined(state: DiffMPCState, known: DiffMPCState, keep: Tensor) -> DiffMPCState:
    """What is known after decisions by several models."""
    return DiffMPCState(
        forecaster=known.forecaster,
        plan=torch.where(keep[:, None, None], known.plan, state.plan),
        waited=torch.where(keep, known.waited, state.waited),
        nearest=torch.where(keep, known.nearest, state.nearest),
        decisions=state.decisions,
    )
