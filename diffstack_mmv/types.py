"""The named records that travel between the stages.

SI units, oldest time first, masks true where valid. T1 are the T + 1 rows of T steps: now and after
each of them.
"""

import math
from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from dmmv_conventions.modes import Mode as Mode  # a field of the records below, and known from here

GRAVITY = 9.81
"""m/s²"""


class SolverStatus(IntEnum):
    """How the optimisation of one problem ended; only converged problems carry a gradient."""

    CONVERGED = 0
    ITERATION_LIMIT = 1
    STALLED = 2
    NOT_FINITE = 3
    INFEASIBLE = 4
    UNBOUNDED = 5

    @property
    def advice(self) -> str:
        """What happened, and what to try."""
        return _ADVICE[self]


_ADVICE = {
    SolverStatus.CONVERGED: "Converged: the projected gradient is within the tolerance.",
    SolverStatus.ITERATION_LIMIT: "The limit was reached: raise `max_iterations` or start closer.",
    SolverStatus.STALLED: "No step lowers the cost: loosen `tolerance`, or solve in float64.",
    SolverStatus.NOT_FINITE: "State, cost or dynamics are NaN or infinite: check the inputs.",
    SolverStatus.INFEASIBLE: "Bounds cross, or no step meets the constraints better: loosen them.",
    SolverStatus.UNBOUNDED: "A control ran off to infinity: give it a bound or a price.",
}


class Motion(NamedTuple):
    """Planar motion of a point and its body.

    Time, where there is one, is the last leading dimension.
    """

    position: Float[Tensor, "*b 2"]  # m
    heading: Float[Tensor, "*b"]  # rad, counter-clockwise from +x
    velocity: Float[Tensor, "*b 2"]  # m/s, in the body frame (forward, left)
    yaw_rate: Float[Tensor, "*b"]  # rad/s


class EgoMeasurement(NamedTuple):
    """What a vehicle measured of itself at the end of a step, and on average in it."""

    position: Float[Tensor, "*b 2"]  # m, of the antenna
    known: Bool[Tensor, "*b"]  # whether there was a position
    steer: Float[Tensor, "*b"]  # rad
    speed: Float[Tensor, "*b"]  # m/s
    yaw_rate: Float[Tensor, "*b"]  # rad/s, NaN without gyro


class EgoEstimate(NamedTuple):
    """What is believed of a vehicle now.

    `instruments` are steering offset (rad) and scale, speed scale, delay (s): the true steering is
    scale times the measured one plus the offset.
    """

    state: Float[Tensor, "*b n"]  # of the model
    motion: Motion  # of the model's reference point
    instruments: Float[Tensor, "*b 4"]
    instruments_std: Float[Tensor, "*b 4"]


class Tracks(NamedTuple):
    """Observed agents."""

    motion: Motion  # *b T
    extent: Float[Tensor, "*b 2"]  # m (length, width)
    mode: Int[Tensor, "*b"]
    valid: Bool[Tensor, "*b T"]

    def present(self) -> "Tracks":
        """The last row alone, of shape (*b,): without a time."""
        motion = Motion(*(field.select(self.valid.dim() - 1, -1) for field in self.motion))
        return self._replace(motion=motion, valid=self.valid[..., -1])


class RecordedScene(NamedTuple):
    """Everybody in a recording, in its world; rows in which somebody is absent are not valid."""

    tracks: Tracks  # n T
    dt_s: float


class Pose(NamedTuple):
    """Where a frame lies in the world of its recording, whose origin may be thousands of km away.

    `data` and `online` make it in float64: float32 knows a place in a map grid to half a metre.
    """

    position: Float[Tensor, "*b 2"]  # m
    heading: Float[Tensor, "*b"]  # rad
    known: Bool[Tensor, "*b"]  # false where no place in the world looks like it, as in a mirror


class StackBatch(NamedTuple):
    """Samples in the frame of the ego at the last row of its past (position 0, heading 0)."""

    ego_past: Tracks  # B H
    ego_future: Tracks  # B T
    neighbors_past: Tracks  # B N H
    neighbors_future: Tracks  # B N T
    goal: Float[Tensor, "B 2"]  # m, the position of the human at the horizon
    dt_s: float
    frame: Pose | None = None  # B, of the samples in the world; None: not known of any


def log_density(
    error: Float[Tensor, "*#b 2"], scale_tril: Float[Tensor, "*#b 2 2"]
) -> Float[Tensor, "*b"]:
    """Log density in nats (per m²) of an error in m under N(0, L Lᵀ), in closed form."""
    first, second = scale_tril[..., 0, 0], scale_tril[..., 1, 1]
    white_first = error[..., 0] / first
    white_second = (error[..., 1] - scale_tril[..., 1, 0] * white_first) / second
    squared = white_first.square() + white_second.square()
    return -0.5 * squared - (first * second).log() - math.log(2 * math.pi)


NEAR_MEDIAN_M = 0.02
"""Distance in m below which a component counts as if it were that far from the median."""
COUNTING_SHARE = 0.02
"""Share in the median from which on a component's path gets a gradient from it."""


class Forecast(NamedTuple):
    """Mixture of Gaussians over the future positions of agents, one weight per whole trajectory."""

    log_weight: Float[Tensor, "*b K"]
    mean: Float[Tensor, "*b K T 2"]  # m
    scale_tril: Float[Tensor, "*b K T 2 2"]  # m

    def log_prob(self, position: Float[Tensor, "*#b #T 2"]) -> Float[Tensor, "*b T"]:
        """Log density in nats of a position at each time, marginal over the components."""
        each = log_density(position.unsqueeze(-3) - self.mean, self.scale_tril)
        return torch.logsumexp(self.log_weight.unsqueeze(-1) + each, -2)

    def most_likely(self) -> Float[Tensor, "*b T 2"]:
        """Mean trajectory in m of the component with the largest weight."""
        return self.likeliest().mean.squeeze(-3)

    def likeliest(self) -> "Forecast":
        """The component with the largest weight alone, which keeps its weight; shape `*b 1`."""
        return taken(self, self.log_weight.argmax(-1, keepdim=True))

    def expected(self) -> Float[Tensor, "*b T 2"]:
        """Expected path in m, the mean of the components' means: the least mean squared error."""
        return (self.log_weight.exp()[..., None, None] * self.mean).sum(-3)

    def median(self, iterations: int = 10) -> Float[Tensor, "*b T 2"]:
        """Path in m with nearly the least expected mean distance to the paths of the components.

        By Weiszfeld's iteration with one share of a component for all times, as the ADE asks for
        one path. A share for each time would come closer, by 0.4 % in the mean over random mixtures
        and 4 % at most. Its gradient is that of the last iteration, and reaches the means of the
        components with at least `COUNTING_SHARE` in it: the decoder leaves out what has none.
        """
        weight = self.log_weight.exp()
        known = self.mean.detach()
        path = (weight[..., None, None] * known).sum(-3)
        share = weight
        for _ in range(iterations):
            distance = (known - path.unsqueeze(-3)).norm(dim=-1).mean(-1).detach()
            share = weight / distance.clamp_min(NEAR_MEDIAN_M)
            share = share / share.sum(-1, keepdim=True)
            path = (share[..., None, None] * known).sum(-3)
        counts = (share >= COUNTING_SHARE)[..., None, None]
        means = torch.where(counts, self.mean, known)
        return (share[..., None, None] * means).sum(-3)


class Obstacles(NamedTuple):
    """Predicted agents that a plan has to keep clear of, at the times of the plan.

    The numbers of those who are not valid count for nothing, but have to be finite, see `of_valid`.
    """

    position: Float[Tensor, "*b N K T1 2"]  # m, row 0 is now
    weight: Float[Tensor, "*b N K"]  # probability of each component
    radius: Float[Tensor, "*b N"]  # m
    valid: Bool[Tensor, "*b N"]

    def of_valid(self) -> "Obstacles":
        """The same with zeros for those who are not valid, whose NaN would spread in gradients."""

        def kept(entry: Tensor) -> Tensor:
            valid = self.valid.reshape(self.valid.shape + (1,) * (entry.dim() - self.valid.dim()))
            return torch.where(valid, entry, torch.zeros_like(entry))

        return Obstacles(kept(self.position), kept(self.weight), kept(self.radius), self.valid)


class HeadingOf(IntEnum):
    """What the heading of an observed motion is the direction of."""

    BODY = 0
    COURSE = 1


class Discs(NamedTuple):
    """Discs that cover the outline of a vehicle, their centres on the axis of its body."""

    ahead: Float[Tensor, "*b D"]  # m, of the reference point along the heading
    radius: Float[Tensor, "*b D"]  # m


class Ego(NamedTuple):
    """The vehicle that a plan is for, as it was observed."""

    motion: Motion  # *b, now
    heading_of: HeadingOf  # what `motion.heading` is the direction of
    discs: Discs  # *b D


class PlanningProblem(NamedTuple):
    """What a planner needs to know, from a data set's batch or from a simulator's observation."""

    ego: Ego
    goal: Float[Tensor, "*b 2"]  # m
    # m, row 0 is now; where the plan would go if nothing were in its way
    reference: Float[Tensor, "*b T1 2"]
    reference_speed: Float[Tensor, "*b"]  # m/s
    obstacles: Obstacles


class Bounds(NamedTuple):
    """Box of admissible controls."""

    lower: Float[Tensor, " m"]
    upper: Float[Tensor, " m"]


class Solution(NamedTuple):
    """Result of a batch of trajectory optimisations, one status per problem."""

    states: Float[Tensor, "*b T1 n"]
    controls: Float[Tensor, "*b T m"]
    cost: Float[Tensor, "*b"]
    residual: Float[Tensor, "*b"]  # largest entry of the projected gradient
    iterations: Int[Tensor, "*b"]
    status: Int[Tensor, "*b"]  # a SolverStatus

    @property
    def converged(self) -> Bool[Tensor, "*b"]:
        """Which problems converged."""
        return self.status == SolverStatus.CONVERGED


class PlanOrigin(IntEnum):
    """Where a chosen plan comes from; a fallback is chosen where no plan is safe."""

    CANDIDATE = 0
    PREVIOUS = 1
    OPTIMISED = 2
    FALLBACK = 3


class Plan(NamedTuple):
    """A plan, with the candidates and the solutions it was chosen from."""

    controls: Float[Tensor, "*b T m"]
    motion: Motion  # *b T1
    origin: Int[Tensor, "*b"]  # a PlanOrigin
    solution: Solution  # *b k, one per start of the optimiser
    candidates: Motion  # *b C T1
    logits: Float[Tensor, "*b C"]  # minus the cost of each candidate

    @property
    def converged(self) -> Bool[Tensor, "*b"]:
        """For which problems every start of the optimiser converged."""
        return self.solution.converged.all(-1)


class Outcome(IntEnum):
    """What one step of a closed-loop episode led to; the last three end the episode."""

    RUNNING = 0
    DISCOMFORT = 1
    COLLISION = 2
    SUCCESS = 3
    TIMEOUT = 4

    @property
    def label(self) -> str:
        """The name in lower case, as tables and files write it."""
        return self.name.lower()

    @property
    def ends_episode(self) -> bool:
        """Whether an episode is over with this outcome."""
        return self >= Outcome.COLLISION


class EpisodeRecord(NamedTuple):
    """Closed-loop episodes; an episode that ended early repeats its last row up to the end."""

    motion: Motion  # E T1, of the robot
    pedestrians: Float[Tensor, "E T1 H 2"]  # m, NaN for those who are absent
    controls: Float[Tensor, "E T m"]
    reward: Float[Tensor, "E T"]  # zero after the end
    # m, smallest over the step that leads to this row (row 0: at the start), inf without anybody
    clearance: Float[Tensor, "E T1"]
    outcome: Int[Tensor, " E"]  # an Outcome
    steps: Int[Tensor, " E"]  # steps until the end
    duration: Float[Tensor, " E"]  # s until the end; the limit for a time-out
    dt_s: float


def on_host(*tensors: Tensor) -> bool:
    """Whether tensors lie in the memory of the host, which then waits for none of their values."""
    return all(tensor.device.type == "cpu" for tensor in tensors)


def map_tensors(function: Callable[..., Tensor], record: Any, *others: Any) -> Any:
    """Apply a function to the tensors of (nested) records, field by field; all else stays."""
    if isinstance(record, Tensor):
        return function(record, *others)
    if isinstance(record, tuple):
        parts = [map_tensors(function, *fields) for fields in zip(record, *others, strict=True)]
        return type(record)(*parts) if hasattr(record, "_fields") else tuple(parts)
    return record


def taken(record: Any, index: Int[Tensor, "*b m"]) -> Any:
    """Take entries `*b m ...` of every tensor `*b n ...` of a record, by their numbers below n."""
    dim = index.dim() - 1

    def entries(tensor: Tensor) -> Tensor:
        place = index.reshape(*index.shape, *(1 for _ in tensor.shape[dim + 1 :]))
        return tensor.take_along_dim(place, dim)

    return map_tensors(entries, record)
