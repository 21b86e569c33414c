"""More proposals where the vehicle is cornered, that is where none of the usual ones is safe."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.planning.candidates import CandidateSource
from diffstack_mmv.planning.pricing import ScoredPlans
from diffstack_mmv.types import Motion, PlanningProblem, map_tensors

Scored = Callable[[PlanningProblem, Tensor, Motion, Tensor], ScoredPlans]


def with_way_out(
    source: CandidateSource,
    dynamics: DynamicsModel,
    scored: Scored,
    problem: PlanningProblem,
    waited: Float[Tensor, "*b"],
    proposals: ScoredPlans,
) -> ScoredPlans:
    """One more proposal, in front of the others.

    Where none of them is safe, it is the best of many more; elsewhere it is not usable. Few
    problems are cornered at a time, so that many proposals cost little.

    Args:
        source: Makes the additional proposals.
        dynamics: The vehicle.
        scored: Scores plans: (problem, controls, motion, waited), one leading dimension.
        problem: The problems, `*b`.
        waited: How long each vehicle has come no closer to its goal, s.
        proposals: What there is so far.
    """
    batch = problem.goal.shape[:-1]
    dims = len(batch)

    def flat(entry: Tensor) -> Tensor:
        return entry.reshape(-1, *entry.shape[dims:])

    def shaped(entry: Tensor) -> Tensor:
        return entry.reshape(*batch, *entry.shape[1:])

    known = map_tensors(flat, proposals)
    found = _unusable(_taken(known))
    rows = (~known.safe.any(-1)).nonzero().squeeze(-1)
    if len(rows):
        own, late = map_tensors(lambda entry: flat(entry)[rows], (problem, waited))
        steps = proposals.controls.shape[-2]
        with torch.no_grad():
            fan = source(dynamics, own, steps)
        more = _taken(scored(own, fan.controls, fan.motion, late))
        pairs = zip(_entries(found), _entries(more), strict=True)
        found = _joined([old.index_copy(0, rows, new) for old, new in pairs])
    return map_tensors(shaped, found).beside(proposals)


def _taken(plans: ScoredPlans) -> ScoredPlans:
    """The best plan of each problem, in a dimension of one."""
    best = plans.best()

    def take(entry: Tensor) -> Tensor:
        return entry.take_along_dim(best.reshape(-1, *(1 for _ in entry.shape[1:])), 1)

    return map_tensors(take, plans)


def _unusable(plans: ScoredPlans) -> ScoredPlans:
    never = torch.full_like(plans.cost, torch.inf)
    return plans._replace(cost=never, safe=torch.zeros_like(plans.safe), shortfall=never)


def _entries(plans: ScoredPlans) -> list[Tensor]:
    return [plans.controls, *plans.motion, *plans[2:]]


def _joined(entries: list[Tensor]) -> ScoredPlans:
    count = len(Motion._fields)
    return ScoredPlans(entries[0], Motion(*entries[1 : 1 + count]), *entries[1 + count :])
