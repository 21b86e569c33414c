"""Whole episodes, all of them as one batch."""

from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.simulation.decisions import Controller, decide, require_controller
from diffstack_mmv.simulation.scene import Scene
from diffstack_mmv.simulation.verdict import Judgement
from diffstack_mmv.simulation.world import World, WorldState
from diffstack_mmv.types import EpisodeRecord, Outcome, map_tensors, taken
from dmmv_conventions.progress import counted


class _Row(NamedTuple):
    """What is recorded per step; `running` is true for the episodes that took part in it."""

    action: Float[Tensor, "E m"]
    judgement: Judgement
    running: Bool[Tensor, " E"]


class DrivenEpisodes(NamedTuple):
    """Driven episodes, and what the controller remembers of them at their end."""

    record: EpisodeRecord
    controller_state: Any


@torch.no_grad()
def drive(world: World, scene: Scene, controller: Controller) -> DrivenEpisodes:
    """Run episodes until each has ended; those that have ended wait for the others.

    Args:
        world: The world.
        scene: Starts of the episodes, one leading dimension `E`.
        controller: Chooses the actions from the observations of all episodes.

    Returns:
        The record of all episodes, as long as the longest of them, and the controller's state.

    Raises:
        ValueError: A pedestrian stands in the robot at the start, or an action has the wrong shape.
        TypeError: The controller is none, or answers with something else than a decision.
    """
    require_controller(controller)
    state = world.start(scene)
    states, rows = [state], []
    running = torch.ones_like(state.time, dtype=torch.bool)
    known = controller.init(world.observe(state))
    for _ in counted(range(world.max_steps), "drive", "step"):
        seen = world.observe(state)._replace(running=running)
        action, known = decide(controller, known, seen)
        state, judgement = world.step(state, action)
        states.append(state)
        rows.append(_Row(action, judgement, running))
        running = running & (judgement.outcome < Outcome.COLLISION)
        if not bool(running.any()):
            break
    return DrivenEpisodes(_record(world, states, rows), known)


def _record(world: World, states: list[WorldState], rows: list[_Row]) -> EpisodeRecord:
    """Join the steps; what happened after the end of an episode is replaced by its last row."""
    action, judgement, running = map_tensors(lambda *each: torch.stack(each, dim=1), *rows)
    steps = running.sum(dim=1)
    row_of = torch.minimum(torch.arange(len(states), device=steps.device), steps[:, None])
    last = (steps - 1)[:, None]
    motions = [world.robot.motion(state.robot) for state in states]
    motion = map_tensors(lambda *each: torch.stack(each, dim=1), *motions)
    clearance = torch.cat((world.clearance(states[0])[:, None], judgement.clearance), dim=1)
    outcome = judgement.outcome.gather(1, last).squeeze(1)
    time = torch.stack([state.time for state in states], dim=1).gather(1, steps[:, None])
    limit = torch.full_like(time.squeeze(1), world.verdict.limit_s)
    return EpisodeRecord(
        motion=taken(motion, row_of),
        pedestrians=taken(torch.stack([_seen(s) for s in states], dim=1), row_of),
        controls=taken(action, row_of[:, :-1].clamp(max=last)),
        reward=torch.where(running, judgement.reward, torch.zeros_like(judgement.reward)),
        clearance=taken(clearance, row_of),
        outcome=outcome,
        steps=steps,
        duration=torch.where(outcome == Outcome.TIMEOUT, limit, time.squeeze(1)),
        dt_s=world.dt_s,
    )


def _seen(state: WorldState) -> Float[Tensor, "E h 2"]:
    """Where the pedestrians are in m, NaN for those who are absent."""
    place = state.pedestrians.position
    return torch.where(
        state.pedestrians.present[..., None], place, torch.full_like(place, torch.nan)
    )
