"""Terms that keep the plan clear of predicted agents."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_at_least, require_positive
from diffstack_mmv.costs.base import CostTerm
from diffstack_mmv.geometry import clearance_lack, direction, left_of
from diffstack_mmv.smooth import safe_norm, smooth_maximum
from diffstack_mmv.types import GRAVITY, Discs, Motion, Obstacles, PlanningProblem


class ExpectedCollision(CostTerm):
    """Radial basis function of the expected distance to each agent, summed over agents.

        C_t = Σ_i exp(-½ (d̄_i / s)²),   d̄_i = Σ_k w_ik ‖p_t - μ_ikt‖

    Source: Karkus et al., DiffStack, Sec. IV (collision term).

    Args:
        bandwidth_m: s in m.

    Raises:
        ValueError: The bandwidth is not positive.
    """

    adds_components = False

    def __init__(self, bandwidth_m: float = 0.6) -> None:
        super().__init__()
        require_positive("bandwidth_m", bandwidth_m)
        self.bandwidth_m = bandwidth_m

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value at each time, dimensionless, at most the number of agents."""
        obstacles = problem.obstacles
        offset = motion.position[..., None, None, :, :] - obstacles.position
        distance = _expected(safe_norm(offset, 1e-4), obstacles)
        value = torch.exp(-0.5 * (distance / self.bandwidth_m).square())
        return _over_agents(value, obstacles)


class OutlineClearance(CostTerm):
    """Squared lack of clearance between the outlines of ego and agents, in m².

        C_t = Σ_i Σ_k w_ik relu(margin - (d_ikt - r_ego - r_i))²

    d is the distance of agent i in component k to the axis of the vehicle between its first and its
    last disc: the outline of the vehicle is the hull of its discs, that of an agent its disc.
    Nothing is paid beyond the margin, and more the deeper an overlap is.

    Args:
        margin_m: Clearance that is kept where it costs nothing, in m.

    Raises:
        ValueError: The margin is negative.
    """

    def __init__(self, margin_m: float = 0.3) -> None:
        super().__init__()
        require_at_least("margin_m", margin_m, 0.0)
        self.margin_m = margin_m

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value in m² at each time, summed over agents."""
        obstacles = problem.obstacles
        lack = clearance_lack(motion, problem.ego.discs, obstacles, self.margin_m)
        return _over_agents(_expected(torch.relu(lack).square(), obstacles), obstacles)


class TurningCircleBarrier(CostTerm):
    """Turning-circle control barrier ReLU(-h)² in m²: active only where both turns are obstructed.

    With the smallest turning radius ρ and the circle centres c_L and c_R, for each agent

        ρ = max(ρ_min, v² / (μ g))
        c_L, c_R = p ± ρ n(θ)
        h_L = ‖o - c_L‖ - (ρ_ego + r_o + margin),  h_R likewise
        h = smooth max(h_L, h_R)

    evaluated at the position of the agent at time t and averaged over the components of its
    mixture. ρ_ego is the circle that the outline of the vehicle sweeps on that turn: ρ + r_ego for
    a disc around the reference point.

    Source:
        Lee et al., TC-CBF (arXiv 2503.20280), as in DMMV, Sec. IV-B.

    Args:
        radius_min_m: ρ_min, the wheelbase over the tangent of the largest steering angle, in m.
        friction: μ.
        margin_m: Clearance kept beyond the two discs in m.
        lead_m: Distance by which the circles are laid ahead of the reference point, in m.

    Raises:
        ValueError: A radius or the friction is not positive, or the margin is negative.
    """

    def __init__(
        self,
        radius_min_m: float = 1.0,
        friction: float = 0.8,
        margin_m: float = 0.2,
        lead_m: float = 0.0,
    ) -> None:
        super().__init__()
        require_positive("radius_min_m", radius_min_m)
        require_positive("friction", friction)
        require_at_least("margin_m", margin_m, 0.0)
        self.radius_min_m = radius_min_m
        self.friction = friction
        self.margin_m = margin_m
        self.lead_m = lead_m

    def barrier(self, motion: Motion, problem: PlanningProblem) -> Float[Tensor, "*b N K t"]:
        """Barrier h in m for each agent and component at each time.

        Negative where both circles are obstructed.
        """
        speed = motion.velocity[..., 0]
        grip = speed.square() / (self.friction * GRAVITY)
        radius = smooth_maximum(grip, torch.full_like(grip, self.radius_min_m), 0.05)
        forward = direction(motion.heading)
        left = left_of(forward)
        centre = motion.position + self.lead_m * forward
        ego = _reach_beyond(problem.ego.discs, radius, self.lead_m)[..., None, None, :]
        keep = ego + problem.obstacles.radius[..., None, None] + self.margin_m
        reach = radius[..., None, None, :] + keep

        x, y = problem.obstacles.position.unbind(-1)

        def clearance(side: float) -> Tensor:
            circle = (centre + side * radius.unsqueeze(-1) * left)[..., None, None, :, :]
            # by components: sums over pairs of numbers would take most of the time
            square = (x - circle[..., 0]).square() + (y - circle[..., 1]).square()
            return (square + 1e-6).sqrt() - reach

        return smooth_maximum(clearance(1.0), clearance(-1.0), 0.05)

    def forward(
        self, motion: Motion, controls: Float[Tensor, "*b t m"], problem: PlanningProblem
    ) -> Float[Tensor, "*b t"]:
        """Value in m² at each time, summed over agents."""
        violation = torch.relu(-self.barrier(motion, problem)).square()
        return _over_agents(_expected(violation, problem.obstacles), problem.obstacles)


def _expected(value: Float[Tensor, "*b N K t"], obstacles: Obstacles) -> Float[Tensor, "*b N t"]:
    """Mean over the components of each agent."""
    return (obstacles.weight.unsqueeze(-1) * value).sum(-2)


def _over_agents(value: Float[Tensor, "*b N t"], obstacles: Obstacles) -> Float[Tensor, "*b t"]:
    """Sum over the agents who are there."""
    return (value * obstacles.valid.unsqueeze(-1)).sum(-2)


def _reach_beyond(
    discs: Discs, radius: Float[Tensor, "*b t"], lead_m: float
) -> Float[Tensor, "*b t"]:
    """How far in m the discs reach beyond the circle of this radius that the vehicle turns on.

    max over discs of sqrt(ρ² + a²) - ρ + r, written as a² / (sqrt(ρ² + a²) + ρ) + r, with a ahead
    of the line on which the centres of the circles are laid.
    """
    ahead, turn = (discs.ahead - lead_m).unsqueeze(-1), radius.unsqueeze(-2)
    beyond = ahead.square() / ((turn.square() + ahead.square()).sqrt() + turn)
    return (beyond + discs.radius.unsqueeze(-1)).amax(-2)
