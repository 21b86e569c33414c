"""The one planner, as training and as closed loop use it."""

import pytest
import torch

from diffstack_mmv import costs
from diffstack_mmv.control import ILQR, ilqr, pad_controls
from diffstack_mmv.dynamics import DiffKBM, ExtendedUnicycle
from diffstack_mmv.planning import (
    CandidateFan,
    CheapestSafe,
    DetourFan,
    MPCPlanner,
    PlannerState,
    PlanPrice,
    Plans,
    Situation,
    TakeOptimum,
    build_problem,
    straight_reference,
)
from diffstack_mmv.planning.plan_costs import PreparedCost
from diffstack_mmv.types import (
    Discs,
    Ego,
    HeadingOf,
    Motion,
    Obstacles,
    PlanOrigin,
    SolverStatus,
    map_tensors,
)
from diffstack_mmv.vehicles import load_vehicle

STEPS = 10


def weighted_cost():
    terms = {
        "goal": costs.FinalGoal(),
        "way": costs.RunningGoal(),
        "collision": costs.ExpectedCollision(),
        "effort": costs.ControlEffort(),
    }
    return costs.WeightedCost(terms, {"goal": 1.0, "way": 0.1, "collision": 1.0, "effort": 0.1})


def problem(batch=4, heading_of=HeadingOf.BODY, seed=0):
    """An ego at 2 m/s with a goal ahead and an agent with two futures beside the way."""
    generator = torch.Generator().manual_seed(seed)
    zero = torch.zeros(batch)
    motion = Motion(torch.zeros(batch, 2), zero, torch.stack([zero + 2, zero], -1), zero)
    goal = torch.tensor([5.0, 0.0]) + torch.randn(batch, 2, generator=generator)
    way = torch.linspace(0, 1, STEPS + 1)[:, None]
    left = torch.tensor([3.0, 1.0]) - way * torch.tensor([0.0, 0.5])
    right = torch.tensor([3.0, -1.0]) + way * torch.tensor([0.0, 0.3])
    futures = torch.stack([left, right]).expand(batch, 1, 2, STEPS + 1, 2)
    obstacles = Obstacles(
        futures.clone(),
        torch.tensor([0.7, 0.3]).expand(batch, 1, 2).clone(),
        torch.full((batch, 1), 0.3),
        torch.ones(batch, 1, dtype=torch.bool),
    )
    discs = Discs(torch.zeros(batch, 1), torch.full((batch, 1), 0.3))
    reference = straight_reference(motion, goal, STEPS, 2.5)
    return build_problem(Ego(motion, heading_of, discs), goal, reference, obstacles)


def training(**settings):
    """The planner as the stack builds it."""
    solver = ILQR(max_iterations=60, tolerance=1e-7)
    model = DiffKBM(load_vehicle("bicycle"), dt_s=0.25)
    return MPCPlanner(model, weighted_cost(), solver, CandidateFan(5, 5), STEPS, **settings)


def driving(starts=2):
    """The planner as the closed loop builds it."""
    planner = training(score=PlanPrice(), starts=starts, choice=CheapestSafe())
    planner.candidates = DetourFan()
    return planner


def memory(batch=4):
    return PlannerState(torch.zeros(batch, STEPS, 2), torch.zeros(batch))


def test_nan_of_agents_who_are_not_there_changes_nothing():
    """Data sets fill absent agents up with NaN."""
    planner, problems = training(), problem()
    obstacles = problems.obstacles

    def beside(value):
        absent = [torch.full_like(entry, value) for entry in obstacles[:3]]
        rows = zip((*obstacles[:3], obstacles.valid), (*absent, ~obstacles.valid), strict=True)
        dims = -4, -2, -1, -1
        joined = (torch.cat(pair, dim) for pair, dim in zip(rows, dims, strict=True))
        return problems._replace(obstacles=Obstacles(*joined))

    weights = list(planner.cost.parameters())
    slopes = []
    for value in (0.0, torch.nan):
        plan = planner(beside(value))
        slopes.append(torch.autograd.grad(plan.controls.square().sum(), weights))
    assert plan.converged.all()
    for found, expected in zip(*reversed(slopes), strict=True):
        assert torch.equal(found, expected)


def test_training_takes_the_optimum_started_from_the_cheapest_candidate():
    planner, problems = training(), problem()
    plan = planner(problems)
    assert plan.solution.status.shape == (4, 1)
    assert plan.converged.all()
    assert torch.equal(plan.controls, plan.solution.controls[:, 0])
    assert (plan.origin == PlanOrigin.OPTIMISED).all()
    assert (plan.solution.cost[:, 0] <= -plan.logits.amax(-1) + 1e-5).all()


@pytest.mark.parametrize("compiler", [True, False])
def test_the_solver_is_compiled_on_demand_where_there_is_a_compiler(compiler, monkeypatch):
    monkeypatch.setattr(ilqr, "can_compile", lambda: compiler)
    planner = training()
    planner.compile_solver()
    assert planner.solver == ILQR(max_iterations=60, tolerance=1e-7, compile=compiler)


def scores(planner, problems, controls, motion):
    """What the planner thinks of plans, `b C`."""
    cost = PreparedCost(planner, problems, in_library=False, differentiable=False)
    situation = Situation(problems, cost, torch.zeros(len(controls)), planner.dynamics.dt_s)
    with torch.no_grad():
        return planner.score(Plans(controls, motion), situation)


def test_the_closed_loop_takes_the_cheapest_safe_plan_of_all():
    planner, problems = driving(), problem()
    with torch.no_grad():
        plan = planner(problems, memory())
        states = plan.solution.states
        motion = planner.dynamics.motion(states, pad_controls(plan.solution.controls))
    one = map_tensors(lambda entry: entry.unsqueeze(1), plan.motion)
    chosen = scores(planner, problems, plan.controls.unsqueeze(1), one)
    solved = scores(planner, problems, plan.solution.controls, motion)
    assert plan.candidates.heading.shape[1] == 109 + 1
    assert plan.solution.status.shape == (4, 2)
    assert chosen.safe.all()
    assert (chosen.cost <= torch.where(solved.safe, solved.cost, torch.inf) + 1e-4).all()


@pytest.mark.parametrize("starts", [0, 1, 3])
def test_any_number_of_starts_gives_a_plan(starts):
    with torch.no_grad():
        plan = driving(starts)(problem(), memory())
    assert plan.controls.shape == (4, STEPS, 2)
    assert plan.solution.controls.shape == (4, starts, STEPS, 2)


@pytest.mark.parametrize("rows", [STEPS, STEPS + 2])
@pytest.mark.parametrize("planner", [training(), driving()], ids=["training", "driving"])
def test_agents_over_another_horizon_are_refused(planner, rows):
    """A library, which knows no shapes, would take one time for another."""
    problems = problem()
    now = problems.obstacles.position[..., :1, :]
    others = problems.obstacles._replace(position=now.repeat_interleave(rows, -2))
    told = f"`problem.obstacles.position` must have 11 rows.* but got {rows}"
    with pytest.raises(ValueError, match=told):
        planner(problems._replace(obstacles=others))


def test_a_problem_that_is_less_precise_than_the_model_is_refused():
    with pytest.raises(ValueError, match="`problem` must be torch.float64 as the dynamics, but"):
        training().double()(problem())


def test_the_optimum_of_no_start_is_refused():
    with pytest.raises(ValueError, match="`starts` must be at least 1"):
        training(starts=0)(problem())


def test_the_rest_of_the_previous_plan_is_a_proposal():
    planner, problems = driving(starts=0), problem()
    with torch.no_grad():
        first = planner(problems, memory())
        again = planner(problems, PlannerState(first.controls, torch.zeros(4)))
    one = map_tensors(lambda entry: entry.unsqueeze(1), first.motion)
    expected = scores(planner, problems, first.controls.unsqueeze(1), one)
    assert torch.allclose(-again.logits[:, -1:], expected.cost, atol=1e-4)


def test_leading_dimensions_are_free():
    """One by one, as a batch and as a grid: the same plans."""
    planner, problems = training(), problem(batch=4)
    whole = planner(problems).controls
    grid = map_tensors(lambda entry: entry.unflatten(0, (2, 2)), problems)
    assert torch.allclose(planner(grid).controls.flatten(0, 1), whole, atol=1e-4)
    single = map_tensors(lambda entry: entry[1], problems)
    assert torch.allclose(planner(single).controls, whole[1], atol=1e-4)


def test_finished_problems_are_left_behind_without_changing_their_answer():
    """Easy and hard problems in one batch: many are selected away before the last one is done."""
    planner = training().double()
    planner.solver = ILQR(max_iterations=60, tolerance=1e-4)
    problems = map_tensors(
        lambda entry: entry.double() if entry.is_floating_point() else entry, problem(batch=40)
    )
    problems.goal[5:] = torch.tensor([5.0, 0.0])
    together = planner(problems).solution
    alone = planner(map_tensors(lambda entry: entry[3:4], problems)).solution
    assert together.iterations.unique().numel() > 3
    assert torch.allclose(alone.controls[0], together.controls[3], atol=1e-9)
    assert int(alone.iterations) == int(together.iterations[3, 0])


def test_a_gradient_reaches_weights_dynamics_goal_and_forecast():
    planner, problems = training(), problem()
    futures = problems.obstacles.position.requires_grad_()
    goal = problems.goal.requires_grad_()
    plan = planner(problems._replace(obstacles=problems.obstacles._replace(position=futures)))
    plan.motion.position[..., -1, :].square().sum().backward()
    (wheelbase,) = planner.dynamics.wheelbase.parameters()
    for reached in (futures, goal, wheelbase, planner.cost.log_weight):
        assert reached.grad.isfinite().all()
        assert reached.grad.abs().max() > 0


def test_a_heading_of_the_body_or_the_course_is_the_same_for_a_model_without_slip():
    planner = training()
    body, course = (planner(problem(heading_of=each)).controls for each in HeadingOf)
    assert torch.equal(body, course)


@pytest.mark.parametrize(
    "planned",
    [lambda problems: training()(problems), lambda problems: driving()(problems, memory())],
    ids=["training", "closed loop"],
)
def test_nobody_around_is_no_special_case(planned):
    problems = problem()
    nobody = map_tensors(lambda entry: entry[:, :0], problems.obstacles)
    with torch.no_grad():
        assert planned(problems._replace(obstacles=nobody)).controls.isfinite().all()


def test_where_the_model_diverges_the_last_of_the_fan_is_driven():
    problems = problem(batch=1)
    lost = problems._replace(goal=problems.goal * torch.nan)
    with torch.no_grad():
        plan = driving(starts=1)(lost, memory(1))
    assert plan.origin.tolist() == [PlanOrigin.FALLBACK]
    assert float(plan.controls[0, 0, 0]) == pytest.approx(
        float(driving().dynamics.bounds.lower[0]), abs=1e-5
    )
    assert int(plan.solution.status) == SolverStatus.NOT_FINITE


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("steps", 0),
        ("steps", 10.5),
        ("starts", -1),
        ("starts", 1.5),
        ("solved_components", 0),
        ("solved_components", 1.0),
    ],
)
def test_numbers_out_of_range_are_refused(name, value):
    planner = training()
    parts = planner.dynamics, planner.cost, planner.solver, planner.candidates
    with pytest.raises(ValueError, match=name):
        MPCPlanner(*parts, **{name: value})


def test_hindsight_takes_frozen_weights_as_they_are():
    planner = training()
    terms = {"goal": costs.FinalGoal(), "effort": costs.ControlEffort()}
    planner.cost = costs.WeightedCost(terms, {"goal": 0.3, "effort": 0.1}, frozen=list(terms))
    given = map_tensors(
        lambda entry: entry.double() if entry.is_floating_point() else entry, problem()
    )
    plan = planner.double()(given)
    cost = planner.cost_of(plan.motion, pad_controls(plan.controls), given).sum(-1)
    found = sum(planner.hindsight_cost(plan, given).values())
    torch.testing.assert_close(found, cost, rtol=1e-14, atol=0)


def test_the_optimum_is_the_best_of_several_starts():
    plan = training(starts=3, choice=TakeOptimum())(problem())
    best = plan.solution.cost.argmin(-1)
    expected = plan.solution.controls[torch.arange(4), best]
    assert torch.equal(plan.controls, expected)


@pytest.mark.parametrize("priced", [True, False])
def test_a_unicycle_at_rest_does_not_back_up_to_a_goal_behind_it(priced):
    terms = {"goal": costs.FinalGoal(), "effort": costs.ControlEffort()}
    weights = {"goal": 1.0, "effort": 0.1}
    if priced:
        terms, weights = terms | {"back": costs.Reversing()}, weights | {"back": 10.0}
    model = ExtendedUnicycle(load_vehicle("bicycle"))
    planner = MPCPlanner(model, costs.WeightedCost(terms, weights), ILQR(), CandidateFan(), 20)
    zero, origin = torch.zeros(1), torch.zeros(1, 2)
    rest = Motion(origin, zero, origin, zero)
    ego = Ego(rest, HeadingOf.COURSE, Discs(torch.zeros(1, 1), torch.full((1, 1), 0.3)))
    goal = torch.tensor([[-0.8, 0.0]])
    nobody = Obstacles(
        torch.zeros(1, 0, 1, 21, 2),
        torch.zeros(1, 0, 1),
        torch.zeros(1, 0),
        torch.zeros(1, 0, dtype=torch.bool),
    )
    reference = straight_reference(rest, goal, 20, 1.0)
    plan = planner(build_problem(ego, goal, reference, nobody))
    slowest = plan.motion.velocity[..., 0].min()
    assert slowest > -0.1 if priced else slowest < -0.3
