"""Every cost term: not negative, the same in every frame, and blind to other times."""

import math

import pytest
import torch

from diffstack_mmv import costs
from diffstack_mmv.geometry import rotate
from diffstack_mmv.types import (
    Discs,
    Ego,
    HeadingOf,
    Motion,
    Obstacles,
    PlanningProblem,
    map_tensors,
)

TERMS = [
    costs.RunningGoal(),
    costs.FinalGoal(),
    costs.HeadingToGoal(),
    costs.ReferenceSpeed(),
    costs.BrakingProfile(),
    costs.ReferenceTracking(),
    costs.ControlEffort(),
    costs.YawRate(),
    costs.LateralAcceleration(),
    costs.ExpectedCollision(),
    costs.OutlineClearance(),
    costs.TurningCircleBarrier(),
    costs.SpeedLimit(),
    costs.Reversing(),
    costs.GoalOutsideTurn(),
]
each_term = pytest.mark.parametrize("term", TERMS, ids=lambda term: type(term).__name__)


def random_case(batch=3, times=6, neighbors=4, components=2, discs_count=2):
    motion = Motion(
        torch.randn(batch, times, 2),
        torch.randn(batch, times),
        torch.randn(batch, times, 2),
        torch.randn(batch, times),
    )
    obstacles = Obstacles(
        torch.randn(batch, neighbors, components, times, 2),
        torch.randn(batch, neighbors, components).softmax(-1),
        torch.rand(batch, neighbors),
        torch.rand(batch, neighbors) > 0.3,
    )
    now = Motion(*(field[:, 0] for field in motion))
    discs = Discs(torch.randn(batch, discs_count), torch.rand(batch, discs_count))
    problem = PlanningProblem(
        Ego(now, HeadingOf.BODY, discs),
        torch.randn(batch, 2),
        torch.randn(batch, times, 2),
        torch.rand(batch),
        obstacles,
    )
    controls = torch.cat([torch.randn(batch, times - 1, 2), torch.zeros(batch, 1, 2)], 1)
    return motion, controls, problem


@each_term
def test_value_is_finite_and_not_negative(term, double):
    value = term(*random_case())
    assert value.shape == (3, 6)
    assert torch.isfinite(value).all()
    assert (value >= 0).all()


@each_term
def test_value_is_the_same_in_every_frame(term, double):
    motion, controls, problem = random_case()
    shift, angle = torch.tensor([2.0, -3.0]), torch.tensor(0.9)

    def move(points):
        return rotate(points, angle.expand(points.shape[:-1])) + shift

    moved = problem._replace(
        goal=move(problem.goal),
        reference=move(problem.reference),
        obstacles=problem.obstacles._replace(position=move(problem.obstacles.position)),
    )
    turned = motion._replace(position=move(motion.position), heading=motion.heading + angle)
    assert torch.allclose(term(motion, controls, problem), term(turned, controls, moved))


@each_term
def test_entry_sees_its_own_time_only(term, double):
    motion, controls, problem = random_case()
    position = motion.position.requires_grad_()
    value = term(motion._replace(position=position), controls, problem)
    for t in range(6):
        gradient = torch.autograd.grad(
            value[:, t].sum() + 0 * position.sum(), position, retain_graph=True
        )[0]
        assert (gradient[:, [s for s in range(6) if s != t]] == 0).all()


@each_term
def test_derivatives_are_finite_on_top_of_goal_and_obstacle(term, double):
    motion, controls, problem = random_case()
    position = problem.goal.unsqueeze(-2).expand(3, 6, 2).clone().requires_grad_()
    on_top = problem.obstacles._replace(
        position=position.detach()[:, None, None].expand(3, 4, 2, 6, 2)
    )
    value = term(motion._replace(position=position), controls, problem._replace(obstacles=on_top))
    (gradient,) = torch.autograd.grad(value.sum() + 0 * position.sum(), position, create_graph=True)
    (second,) = torch.autograd.grad(gradient.sum() + 0 * position.sum(), position)
    assert torch.isfinite(gradient).all()
    assert torch.isfinite(second).all()


@each_term
def test_cases_in_a_grid_are_scored_as_in_a_row(term, double) -> None:
    case = random_case(batch=6)
    grid = map_tensors(lambda tensor: tensor.unflatten(0, (2, 3)), case)
    assert torch.equal(term(*grid).flatten(0, 1), term(*case))


@each_term
def test_many_candidates_are_scored_against_one_problem(term, double) -> None:
    motion, controls, problem = random_case(batch=3)
    grid = map_tensors(lambda tensor: torch.stack([tensor, 2 * tensor]), (motion, controls))
    for number, value in enumerate(term(*grid, problem)):
        alone = map_tensors(lambda tensor, number=number: tensor[number], grid)
        assert torch.allclose(value, term(*alone, problem))


@each_term
def test_no_agents_is_no_special_case(term, double):
    motion, controls, problem = random_case(neighbors=0)
    assert torch.isfinite(term(motion, controls, problem)).all()


def paid_beside(term, discs, x, y, radius):
    """What a vehicle at rest in the origin pays for one agent at (x, y) m of a radius in m."""
    motion, controls, problem = random_case(batch=1, times=1, neighbors=1, components=1)
    still = map_tensors(torch.zeros_like, motion)
    place = torch.tensor([x, y]).reshape(1, 1, 1, 1, 2)
    agent = Obstacles(place, torch.ones(1, 1, 1), torch.full((1, 1), radius), torch.ones(1, 1) > 0)
    ego = problem.ego._replace(discs=discs)
    return term(still, controls, problem._replace(obstacles=agent, ego=ego)).item()


@pytest.mark.parametrize(
    ("x", "y", "paid"), [(0.5, 0.76, 0.0), (-2.0, 0.0, 0.0), (0.5, 0.55, 0.04), (1.55, 0.0, 0.04)]
)
def test_outline_clearance_is_paid_within_the_margin_of_the_outline_only(x, y, paid, double):
    discs = Discs(torch.tensor([[-1.0, 1.0]]), torch.full((1, 2), 0.3))
    found = paid_beside(costs.OutlineClearance(margin_m=0.2), discs, x, y, 0.25)
    assert found == pytest.approx(paid, rel=1e-4)


@pytest.mark.parametrize(
    ("x", "y", "active"), [(0.5, 0.0, True), (0.0, 1.0, False), (5.0, 0.0, False)]
)
def test_barrier_is_active_only_where_both_turns_are_obstructed(x, y, active, double):
    term = costs.TurningCircleBarrier(radius_min_m=1.0, margin_m=0.0)
    discs = Discs(torch.zeros(1, 1), torch.full((1, 1), 0.3))
    assert (paid_beside(term, discs, x, y, 0.3) > 0) is active


@pytest.mark.parametrize("lead_m", [-0.5, 0.0, 0.4])
def test_the_barrier_is_the_circle_that_the_outline_sweeps(lead_m, double):
    radius, agent = 1.3, 0.2
    term = costs.TurningCircleBarrier(radius_min_m=radius, margin_m=0.0, lead_m=lead_m)
    _, _, problem = random_case(batch=1, times=1, neighbors=1, components=1)
    discs = Discs(torch.tensor([[-0.4, 0.1, 0.7]]), torch.tensor([[0.3, 0.4, 0.25]]))
    centre, edge = torch.tensor([lead_m, radius]), torch.linspace(0, 2 * torch.pi, 3601)
    around = torch.stack([edge.cos(), edge.sin()], -1)
    middles = torch.stack([discs.ahead[0], torch.zeros(3)], -1).unsqueeze(1)
    outline = middles + discs.radius[0, :, None, None] * around
    swept = float((outline - centre).norm(dim=-1).max())
    # touches the circle of the left turn, well within that of the right one
    touching = Obstacles(
        torch.tensor([lead_m, radius - swept - agent]).reshape(1, 1, 1, 1, 2),
        torch.ones(1, 1, 1),
        torch.full((1, 1), agent),
        torch.ones(1, 1, dtype=torch.bool),
    )
    problem = problem._replace(obstacles=touching, ego=problem.ego._replace(discs=discs))
    still = Motion(torch.zeros(1, 1, 2), torch.zeros(1, 1), torch.zeros(1, 1, 2), torch.zeros(1, 1))
    assert float(term.barrier(still, problem)) == pytest.approx(0.0, abs=2e-3)


def test_braking_profile_asks_for_rest_at_the_goal_and_for_cruise_far_away(double):
    term = costs.BrakingProfile(1.5)
    motion, controls, problem = random_case(batch=1, times=1)
    problem = problem._replace(goal=torch.zeros(1, 2), reference_speed=torch.full((1,), 3.0))

    def value(distance, speed):
        at = motion._replace(
            position=torch.tensor([[[distance, 0.0]]]), velocity=torch.tensor([[[speed, 0.0]]])
        )
        return term(at, controls, problem).item()

    assert value(0.0, 0.0) < 1e-2
    assert value(100.0, 3.0) < 1e-2
    assert value(0.0, 3.0) > 5


@pytest.mark.parametrize(
    ("braking", "distance", "speed"),
    [(1.5, 0.3, 0.808), (1.5, 0.03, 0.116), (1.5, 0, 0.0), (3.0, 0.3, 1.180), (3.0, 0.03, 0.193)],
)
def test_braking_profile_asks_near_the_goal_for_what_it_says(double, braking, distance, speed):
    motion, controls, problem = random_case(batch=1, times=1)
    problem = problem._replace(goal=torch.zeros(1, 2), reference_speed=torch.full((1,), 3.0))
    at = motion._replace(
        position=torch.tensor([[[distance, 0.0]]]), velocity=torch.tensor([[[speed, 0.0]]])
    )
    assert costs.BrakingProfile(braking)(at, controls, problem).item() < 1e-5


@pytest.mark.parametrize(
    "term", [costs.RunningGoal(), costs.FinalGoal(), costs.HeadingToGoal(), costs.BrakingProfile()]
)
@pytest.mark.parametrize("course", [0.0, 1.0, 2.0, 3.0])
def test_no_term_has_a_tip_at_the_goal(double, term, course):
    # a plan that ends on a tip cannot be told from one that is not solved
    _, controls, problem = random_case(batch=1, times=1)
    problem = problem._replace(goal=torch.zeros(1, 2), reference_speed=torch.full((1,), 3.0))

    def slope(place):
        place = torch.tensor(place, requires_grad=True)
        at = moving((0.0, 0.0))._replace(position=place[None, None])
        (found,) = torch.autograd.grad(term(at, controls, problem).sum(), place)
        return found

    step = [3e-6 * math.cos(course), 3e-6 * math.sin(course)]
    assert (slope(step) - slope([-way for way in step])).norm() < 0.02


@pytest.mark.parametrize(
    ("make", "name", "least"),
    [
        (costs.HeadingToGoal, "fade_m", "positive"),
        (costs.BrakingProfile, "braking_mps2", "positive"),
        (costs.GoalOutsideTurn, "radius_min_m", "positive"),
        (costs.ExpectedCollision, "bandwidth_m", "positive"),
        (costs.OutlineClearance, "margin_m", "at least 0"),
        (costs.TurningCircleBarrier, "radius_min_m", "positive"),
        (costs.TurningCircleBarrier, "friction", "positive"),
        (costs.TurningCircleBarrier, "margin_m", "at least 0"),
    ],
)
def test_impossible_constants_are_refused(make, name, least):
    for value in (-1.0, *([0.0] if least == "positive" else [])):
        with pytest.raises(ValueError, match=f"`{name}` must be {least}"):
            make(**{name: value})
    if least != "positive":
        make(**{name: 0.0})


def test_the_speed_limit_holds_backwards_too(double):
    motion, controls, problem = random_case()
    speed = torch.tensor([3.0, -3.0, 0.5, -0.5, 1.0, -1.0]).expand(3, 6)
    motion = motion._replace(velocity=torch.stack([speed, torch.zeros_like(speed)], -1))
    problem = problem._replace(reference_speed=torch.ones(3))
    value = costs.SpeedLimit()(motion, controls, problem)
    assert torch.allclose(value, torch.tensor([4.0, 4.0, 0.0, 0.0, 0.0, 0.0]).expand(3, 6))


def moving(position, heading=0.0, velocity=(1.0, 0.0), yaw_rate=0.0):
    """A motion of one sample at one time."""
    place, speed = torch.tensor([[position]]), torch.tensor([[velocity]])
    return Motion(place, torch.tensor([[heading]]), speed, torch.tensor([[yaw_rate]]))


VALUES = {
    "the goal behind fades": (costs.HeadingToGoal(2.0), moving((2.0, 0.0)), 8 / 8),
    "the goal abeam fades": (costs.HeadingToGoal(0.5), moving((0.0, 1.0)), 1 / 1.25),
    "a goal on the left": (costs.GoalOutsideTurn(1.0), moving((0.0, -0.5)), 0.25),
    "a goal on the right": (costs.GoalOutsideTurn(1.0), moving((0.0, 0.5)), 0.25),
    "a turn": (costs.YawRate(), moving((0.0, 0.0), 0.0, (3.0, 0.2), 0.5), 0.25),
    "a fast turn": (costs.LateralAcceleration(), moving((0.0, 0.0), 0.0, (3.0, 0.2), 0.5), 2.25),
}


@pytest.mark.parametrize(("term", "motion", "value"), VALUES.values(), ids=VALUES)
def test_value_is_the_printed_formula(term, motion, value):
    _, controls, problem = random_case(batch=1, times=1)
    found = term(motion, controls, problem._replace(goal=torch.zeros(1, 2)))
    assert float(found) == pytest.approx(value, abs=1e-5)
