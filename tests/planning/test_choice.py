"""Which of the proposals and solutions is driven, and what it is called."""

import pytest
import torch

from diffstack_mmv.planning import CheapestSafe, Plans, ScoredPlans, TakeOptimum
from diffstack_mmv.planning.choice import Options
from diffstack_mmv.types import Motion, PlanOrigin, Solution, map_tensors

INF = float("inf")
FAN = 2  # plans 0 and 1; plan 2 is the previous one, plans 3 and 4 are solutions


def plans_numbered(*numbers):
    """Plans of one problem, each of which has its number everywhere."""
    number = torch.tensor([numbers], dtype=torch.float32)
    rows = number[..., None].expand(-1, -1, 3)
    pair = rows[..., None].expand(-1, -1, -1, 2)
    return Plans(pair[:, :, :2], Motion(pair, rows, pair, rows))


def options_of(cost=(0.0, 0.0), scored=None):
    """Three proposals, and two solutions of these costs."""
    zero = torch.zeros(1, 2)
    pair = torch.zeros(1, 2, 1, 1)
    given = torch.tensor([cost])
    solution = Solution(pair, pair, given, zero, zero.long(), zero.long())
    return Options(scored, FAN, solution, plans_numbered(3, 4))


def scored_of(numbers, entries):
    cost, safe, shortfall = (torch.tensor([column]) for column in zip(*entries, strict=True))
    return ScoredPlans(plans_numbered(*numbers), cost, safe, shortfall)


def chosen(entries):
    """The plan chosen of five with these (cost, safe, shortfall), and its origin."""
    first = scored_of((0, 1, 2), entries[:3])
    found = CheapestSafe()(
        options_of(scored=first), lambda *_: scored_of((3, 4), entries[3:]), None
    )
    assert found.controls.shape == (1, 2, 2)
    number = int(found.controls[0, 0, 0])
    for part in (found.controls, *found.motion):
        assert bool((part == number).all())
    return number, PlanOrigin(int(found.origin))


SAFE = (5.0, True, 0.0)


@pytest.mark.parametrize(
    ("number", "origin"),
    [
        (0, PlanOrigin.CANDIDATE),
        (1, PlanOrigin.CANDIDATE),
        (2, PlanOrigin.PREVIOUS),
        (3, PlanOrigin.OPTIMISED),
        (4, PlanOrigin.OPTIMISED),
    ],
)
@pytest.mark.usefixtures("unchecked")  # a score that knows no situation
def test_the_cheapest_safe_plan_is_called_by_where_it_comes_from(number, origin):
    cheaper = (1.0, False, 0.1)  # but refused
    entries = [SAFE, SAFE, SAFE, SAFE, SAFE]
    entries[number] = (4.0, True, 0.0)
    entries[(number + 1) % 5] = cheaper
    assert chosen(entries) == (number, origin)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("number", range(5))
def test_where_nothing_is_safe_the_plan_that_lacks_least_clearance_is_a_fallback(number):
    entries = [(1.0, False, 0.5)] * 5
    entries[number] = (9.0, False, 0.2)
    assert chosen(entries) == (number, PlanOrigin.FALLBACK)


@pytest.mark.usefixtures("unchecked")
def test_where_no_plan_is_finite_the_last_of_the_fan_is_the_fallback():
    assert chosen([(INF, False, INF)] * 5) == (FAN - 1, PlanOrigin.FALLBACK)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("shape", [(3,), (1, 3), (3, 1)])
def test_each_problem_of_a_batch_chooses_for_itself(shape):
    def scored(numbers, cost):
        plans = map_tensors(lambda entry: torch.cat([entry] * 3), plans_numbered(*numbers))
        whole = ScoredPlans(plans, cost, cost.isfinite(), torch.zeros_like(cost))
        return map_tensors(lambda entry: entry.unflatten(0, shape), whole)

    first = scored((0, 1, 2), torch.tensor([[5.0, 4.0, 6.0], [5.0, 4.0, 3.0], [INF] * 3]))
    solved = scored((3, 4), torch.tensor([[7.0, 7.0], [2.0, 7.0], [INF] * 2]))
    found = CheapestSafe()(options_of(scored=first), lambda *_: solved, None)
    assert found.controls.shape == (*shape, 2, 2)
    found = map_tensors(torch.Tensor.squeeze, found)
    assert found.controls[:, 0, 0].tolist() == [1, 3, FAN - 1]
    assert torch.equal(found.motion.heading[:, 0], found.controls[:, 0, 0])
    names = [PlanOrigin.CANDIDATE, PlanOrigin.OPTIMISED, PlanOrigin.FALLBACK]
    assert found.origin.tolist() == names


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(("cost", "number"), [((2.0, 1.0), 4), ((1.0, 2.0), 3)])
def test_the_optimum_is_the_solution_of_least_cost(cost, number):
    found = TakeOptimum()(options_of(cost), None, None)
    assert float(found.controls[0, 1, 1]) == number
    assert found.origin.tolist() == [PlanOrigin.OPTIMISED]


@pytest.mark.usefixtures("unchecked")
def test_an_optimum_needs_a_solution():
    options = options_of()
    none = options.solution._replace(cost=torch.zeros(1, 0))
    with pytest.raises(ValueError, match=r"`starts` must be at least 1, .* the optimum is taken"):
        TakeOptimum()(options._replace(solution=none), None, None)
