"""Losses on closed-loop episodes whose gradient reaches the cost weights of a controller."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least
from diffstack_mmv.simulation.decisions import Controller, decide
from diffstack_mmv.simulation.scene import Scene
from diffstack_mmv.simulation.world import World


def imitation_loss(
    world: World, scene: Scene, learner: Controller, teacher: Controller, steps: int
) -> Float[Tensor, ""]:
    """How far the learner's actions are from the teacher's, on the way that the learner takes.

        L = mean over episodes, steps, controls of ((u - u*) / largest control)²

    The teacher is asked where the learner has come to, so that the learner sees its own mistakes.
    The gradient runs through the solutions of the optimiser and through the motion of the robot.

    Args:
        world: Where both drive; its robot must be differentiable, as a `VehicleRobot` is.
        scene: Starts of the episodes, one leading dimension.
        learner: Learns; a `DiffMPCController` whose planner takes the optimum.
        teacher: Acts as the learner should.
        steps: Number of decisions.

    Returns:
        The loss, dimensionless.

    Raises:
        ValueError: There is no step, or a pedestrian stands in the robot at the start.

    Source:
        Amos et al., Differentiable MPC for end-to-end planning and control (NeurIPS 2018), for the
        imitation; Ross et al., A reduction of imitation learning to no-regret online learning
        (2011), for the learner's own way.
    """
    require_at_least("steps", steps, 1)
    state, errors = world.start(scene), []
    seen = world.observe(state)
    own, taught = learner.init(seen), teacher.init(seen)
    bounds = world.robot.bounds
    largest = torch.maximum(bounds.upper, -bounds.lower)
    for _ in range(steps):
        seen = world.observe(state)
        action, own = decide(learner, own, seen)
        with torch.no_grad():
            wanted, taught = decide(teacher, taught, seen)
        errors.append(((action - wanted) / largest.to(action)).square().mean())
        state = world.step(state, action).state
    return torch.stack(errors).mean()


def way_left_loss(world: World, scene: Scene, learner: Controller, steps: int) -> Float[Tensor, ""]:
    """Mean distance to the goal in m that the learner has left after some decisions.

    Args:
        world: Where it drives; its robot must be differentiable, as a `VehicleRobot` is.
        scene: Starts of the episodes, one leading dimension.
        learner: Learns; a `DiffMPCController` whose planner takes the optimum.
        steps: Number of decisions.

    Returns:
        The loss in m.

    Raises:
        ValueError: There is no step, or a pedestrian stands in the robot at the start.
    """
    require_at_least("steps", steps, 1)
    state = world.start(scene)
    known = learner.init(world.observe(state))
    for _ in range(steps):
        action, known = decide(learner, known, world.observe(state))
        state = world.step(state, action).state
    return world.way_left(state).mean()
