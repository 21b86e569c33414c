"""What whole episodes cost, as a number whose gradient runs through `World.step`."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.simulation.decisions import Controller, decide
from diffstack_mmv.simulation.scene import Scene
from diffstack_mmv.simulation.world import World


@dataclass(frozen=True)
class DrivingLoss:
    """Time on the way and lack of clearance, until the goal.

        L = Σ_t [not arrived] dt (d_t / (d_t + r) + w (max(0, m - c_t) / m)²)

    with the distance d to the goal and the smallest clearance c of the step. Who is on the way pays
    for the time, and near the goal for what is left; a price in proportion to d would let a vehicle
    stop half a metre short of it for next to nothing. An episode goes on after a contact, so that
    the loss has no jump there.

    Attributes:
        clearance_m: m, below which clearance is lacking.
        clearance_weight: w; 1 makes a second of contact as bad as a second on the way.
        near_m: r, the distance at which a second costs half of one far away.
        steps: Decisions after which an episode is cut.
        arrived_m: Who is nearer to the goal has arrived.

    Raises:
        ValueError: A number is not positive, or the weight negative.
    """

    clearance_m: float = 0.35
    clearance_weight: float = 10.0
    near_m: float = 0.5
    steps: int = 40
    arrived_m: float = 0.3

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_positive("clearance_m", self.clearance_m)
        require_positive("arrived_m", self.arrived_m)
        require_positive("near_m", self.near_m)
        require_at_least("clearance_weight", self.clearance_weight, 0)
        require_at_least("steps", self.steps, 1)

    def __call__(
        self, world: World, scene: Scene, controller: Controller
    ) -> Float[Tensor, " episodes"]:
        """The loss of each episode in s.

        Args:
            world: Where it drives; for a gradient its robot must be a `VehicleRobot`.
            scene: Starts of the episodes, one leading dimension.
            controller: For a gradient a `DiffMPCController` whose planner takes the optimum.

        Raises:
            ValueError: A pedestrian stands in the robot at the start.
        """
        state = world.start(scene)
        seen = world.observe(state)
        known, total = controller.init(seen), torch.zeros_like(state.time)
        running = torch.ones_like(state.time, dtype=torch.bool)
        for _ in range(self.steps):
            seen = world.observe(state)._replace(running=running)
            action, known = decide(controller, known, seen)
            state, judgement = world.step(state, action)
            way = world.way_left(state)
            lack = (1 - judgement.clearance / self.clearance_m).clamp_min(0)
            cost = world.dt_s * (way / (way + self.near_m) + self.clearance_weight * lack.square())
            total = total + torch.where(running, cost, 0.0)
            running = running & (way.detach() >= self.arrived_m)
            if not bool(running.any()):
                break
        return total
