"""Whether anybody could have avoided a collision, knowing every walk beforehand."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_between
from diffstack_mmv.simulation.pedestrians import VisibleRobot
from diffstack_mmv.simulation.scene import CaseSource, Scene
from diffstack_mmv.simulation.world import World
from diffstack_mmv.types import Outcome, map_tensors
from dmmv_conventions.progress import counted

BEYOND_S = 0.75
"""How much longer than up to the collision a drive has to stay free of one."""


@dataclass(frozen=True)
class AvoidanceSearch:
    """Drives many random sequences of actions through a case, with the vehicle's own dynamics.

    Half of the actions lie on the bounds, and each is held on with probability one half. Whoever
    finds none that arrives, or is free of collisions up to a time, has no proof that there is none,
    but in the first seconds of a case, in which a vehicle can do little, the samples lie dense.

    Args:
        samples: Sequences that are tried.
        seed: Of the random numbers.

    Raises:
        ValueError: There is no sample.
    """

    samples: int = 4096
    seed: int = 0

    def __post_init__(self) -> None:
        require_at_least("samples", self.samples, 1)

    def judge(
        self, world: World, scenario: CaseSource, phase: str, cases: Sequence[dict[str, Any]]
    ) -> dict[str, Any]:
        """Say of each collision whether it could have been avoided, and leave out the others.

        Args:
            world: The world of the vehicle.
            scenario: Where the cases come from.
            phase: Of the cases.
            cases: What `summarise` tells of them, which is completed by `avoidable`.

        Returns:
            Number of feasible cases, and success and collision rate among them; None without any.
        """
        collided = [case for case in cases if case["outcome"] == Outcome.COLLISION.label]
        for case in counted(collided, "search avoidable collisions", "case"):
            scene = scenario.cases(phase, [case["case"]])
            until = min(case["time_s"] + BEYOND_S, world.verdict.limit_s)
            case["avoidable"] = self(world, scene, until)
        feasible = [case for case in cases if case.get("avoidable", 1.0) > 0]

        def rate(outcome: Outcome) -> float | None:
            ended = [case["outcome"] == outcome.label for case in feasible]
            return sum(ended) / len(ended) if ended else None

        return {
            "n": len(feasible),
            "success_rate": rate(Outcome.SUCCESS),
            "collision_rate": rate(Outcome.COLLISION),
        }

    @torch.no_grad()
    def __call__(self, world: World, scene: Scene, until_s: float) -> float:
        """Share of the sequences that reach the goal, or pass up to a time, without a collision.

        Args:
            world: The world with its robot; pedestrians that see it react to every sequence.
            scene: One case, in a leading dimension of one.
            until_s: Time up to which the way has to be free: that of the collision, and some more.

        Raises:
            ValueError: The time does not lie within the limit of the world.
        """
        require_between("until_s", until_s, world.dt_s, world.verdict.limit_s)
        generator = torch.Generator().manual_seed(self.seed)
        steps = round(until_s / world.dt_s)
        if not world.robot_visible:
            # all sequences meet the same walks: nobody has to walk them thousands of times
            foretold = _Foretold(iter(_walks(world, scene, steps)))
            world, scene = replace(world, crowd=foretold), scene._replace(itinerary=None)
        many = map_tensors(lambda part: part.expand(self.samples, *part.shape[1:]).clone(), scene)
        state, free, arrived = world.start(many), torch.arange(self.samples), 0
        action = self._drawn(world, generator)
        for _ in range(steps):
            state, judgement = world.step(state, action[free])
            # whoever has arrived has nobody to give way to any more
            won = judgement.outcome == Outcome.SUCCESS
            arrived += int(won.sum())
            kept = ~won & (judgement.outcome != Outcome.COLLISION)
            state, free = map_tensors(lambda part, kept=kept: part[kept], state), free[kept]
            if not len(free):
                break
            held = torch.rand(self.samples, 1, generator=generator) < 0.5
            action = torch.where(held, action, self._drawn(world, generator))
        return (arrived + len(free)) / self.samples

    def _drawn(self, world: World, generator: torch.Generator) -> Float[Tensor, "S m"]:
        """Actions within the bounds, half of them on the bounds."""
        lower, upper = world.robot.bounds
        share = torch.rand(self.samples, len(lower), generator=generator, dtype=torch.float64)
        extreme = torch.rand(self.samples, 1, generator=generator) < 0.5
        share = torch.where(extreme, share.round(), share).to(lower)
        return lower + share * (upper - lower)


@dataclass(frozen=True)
class _Foretold:
    """A crowd that walks as told, in many episodes at once."""

    velocities: Iterator[Float[Tensor, "one h 2"]]

    def __call__(
        self, crowd: Any, dt_s: float, robot: VisibleRobot | None = None
    ) -> Float[Tensor, "S h 2"]:
        return next(self.velocities).expand_as(crowd.position)


def _walks(world: World, scene: Scene, steps: int) -> list[Float[Tensor, "one h 2"]]:
    """Velocities in m/s of a crowd that does not see the robot, step by step."""
    state, velocities = world.start(scene), []
    action = torch.stack(list(world.robot.bounds)).mean(0, keepdim=True)
    for _ in range(steps):
        # the same state is always followed by the same step
        velocities.append(world.crowd(state.pedestrians, world.dt_s))
        state, _ = world.step(state, action)
    return velocities
