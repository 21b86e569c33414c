"""Limits as constraints of the optimiser: what they say, and that plans keep to them."""

import dataclasses

import pytest
import torch

from diffstack_mmv.control import ILQR
from diffstack_mmv.dynamics import DiffKBM, Holonomic
from diffstack_mmv.planning import (
    ClearanceKept,
    DetourFan,
    FrictionCircle,
    MPCPlanner,
    PlanConstraints,
    SpeedWithin,
    above_rest,
)
from diffstack_mmv.types import Motion, SolverStatus
from diffstack_mmv.vehicles import load_vehicle
from tests.planning.test_planner import STEPS, problem, training, weighted_cost

LIMITS = {
    "speed": SpeedWithin(),
    "friction": FrictionCircle(0.3),
    "clearance": ClearanceKept(0.1),
}


def motion(speed, yaw_rate, x=0.0):
    """Two problems at two times, all alike."""
    shape = torch.zeros(2, 2)
    velocity = torch.stack([shape + speed, shape], -1)
    return Motion(torch.stack([shape + x, shape], -1), shape, velocity, shape + yaw_rate)


def cut(problems):
    """A problem for two times."""
    obstacles = problems.obstacles._replace(position=problems.obstacles.position[..., :2, :])
    return problems._replace(obstacles=obstacles)


def test_the_speed_limit_is_the_reference_speed_and_its_excess():
    problems = problem(2)._replace(reference_speed=torch.tensor([3.0, 4.0]))
    values = SpeedWithin(0.5)(motion(4.0, 0.0), torch.zeros(2, 2), problems)
    assert values.squeeze(-1).tolist() == [[0.5, 0.5], [-0.5, -0.5]]


def test_the_friction_circle_is_reached_by_braking_and_turning_together():
    grip = 0.8 * 9.81
    values = FrictionCircle(0.8)(
        motion(2.0, 0.3 * grip), torch.full((2, 2), -0.8 * grip), problem(2)
    )
    torch.testing.assert_close(values, torch.zeros(2, 2, 1), atol=1e-6, rtol=0)


def test_clearance_is_told_for_every_agent_and_component_and_only_for_those_present():
    problems = cut(problem(2))
    values = ClearanceKept(0.1)(motion(2.0, 0.0, x=1.0), torch.zeros(2, 2), problems)
    reach = problems.ego.discs.radius.amax(-1) + problems.obstacles.radius[:, 0] + 0.1
    expected = (
        reach[:, None, None]
        - (problems.obstacles.position[:, 0] - torch.tensor([1.0, 0.0])).norm(dim=-1).mT
    )
    assert values.shape == (2, 2, 2)
    torch.testing.assert_close(values, expected, atol=1e-4, rtol=1e-4)
    gone = problems.obstacles._replace(valid=torch.zeros(2, 1, dtype=torch.bool))
    values = ClearanceKept(0.1)(
        motion(2.0, 0.0), torch.zeros(2, 2), problems._replace(obstacles=gone)
    )
    assert (values == -1).all()


@pytest.mark.parametrize(("kind", "argument"), [(FrictionCircle, 0.0), (ClearanceKept, -0.1)])
def test_numbers_of_limits_are_checked(kind, argument):
    with pytest.raises(ValueError, match="must be"):
        kind(argument)


def limited(linear=float("inf"), max_iterations=40):
    """A planner whose optimiser keeps to all limits, in float64."""
    planner = training()
    planner.solver = ILQR(max_iterations=60, tolerance=1e-8)
    planner.constraints = PlanConstraints(LIMITS, linear, max_iterations, tolerance=1e-6)
    return planner.double()


def doubled(record):
    """The same problem in float64."""
    fields = [
        each.double()
        if isinstance(each, torch.Tensor) and each.is_floating_point()
        else doubled(each)
        if isinstance(each, tuple)
        else each
        for each in record
    ]
    return type(record)(*fields)


@pytest.mark.parametrize("linear", [float("inf"), 100.0])
def test_plans_keep_to_limits_that_the_plain_optimum_breaks(linear):
    problems = doubled(problem(2))
    problems = problems._replace(reference_speed=torch.tensor([2.2, 2.5]).double())

    def worst(planner):
        plan = planner(problems)
        command = torch.nn.functional.pad(plan.controls[..., 0], (0, 1))
        values = {name: limit(plan.motion, command, problems) for name, limit in LIMITS.items()}
        decided = values.pop("friction").amax((1, 2))
        return plan, torch.cat([*values.values()], -1)[:, 1:].amax((1, 2)).maximum(decided)

    planner = limited(linear)
    plan, lack = worst(planner)
    assert plan.solution.converged.all()
    assert (lack < 1e-4).all()
    planner.constraints = dataclasses.replace(planner.constraints, limits={})
    assert (worst(planner)[1] > 0.1).all()


def sharp(model, friction):
    """A plan to a goal aside of a vehicle at 4 m/s, and what the friction circle says of it."""
    circle = FrictionCircle(friction)
    parts = weighted_cost(), ILQR(max_iterations=200), DetourFan(), STEPS
    limits = PlanConstraints({"circle": circle}, max_iterations=150)
    planner = MPCPlanner(model, *parts, constraints=limits).double()
    aside = doubled(problem(1))
    aside.ego.motion.velocity[:, 0], aside.goal[:] = 4.0, torch.tensor([4.0, 4.0])
    plan = planner(aside._replace(obstacles=aside.obstacles._replace(radius=torch.zeros(1, 1))))
    command = torch.nn.functional.pad(plan.controls[..., 0], (0, 1))
    return plan, circle(plan.motion, command, aside).squeeze(-1)


@pytest.mark.parametrize("friction", [0.2, 0.3, 0.4])
def test_the_control_that_is_driven_is_within_the_friction_circle(friction) -> None:
    plan, values = sharp(DiffKBM(load_vehicle("bicycle"), 0.25), friction)
    assert plan.solution.converged.all()
    torch.testing.assert_close(values[:, :4], torch.zeros_like(values[:, :4]), atol=1e-9, rtol=0)
    assert (values < 1e-9).all()


@pytest.mark.parametrize("linear", [float("inf"), 100.0])
def test_plans_that_stop_under_limits_converge(linear):
    # without coordinates above rest they stay where they start: on the kink of the floor at rest
    planner = limited(linear)
    planner.coordinates = above_rest
    problems = doubled(problem(4))
    problems.ego.motion.velocity[:, 0] = torch.tensor([3.0, 2.5, 2.0, 1.0])
    problems.goal[:] = torch.tensor([0.3, 0.0])
    problems = problems._replace(reference_speed=torch.full((4,), 3.0).double())
    plan = planner(problems)
    assert plan.solution.states[..., 3].amin(-1).max() < 1e-3
    assert plan.solution.converged.all()


@pytest.mark.parametrize(
    ("linear", "status"),
    [(float("inf"), SolverStatus.INFEASIBLE), (100.0, SolverStatus.CONVERGED)],
)
def test_what_cannot_be_kept_to_is_told_or_paid(linear, status):
    problems = doubled(problem(1))
    inside = problems.obstacles._replace(radius=problems.obstacles.radius + 40)
    # within fewer iterations a step still lowers the violation: ITERATION_LIMIT, see `solve`
    plan = limited(linear, max_iterations=80)(problems._replace(obstacles=inside))
    assert plan.solution.status.tolist() == [[status]]
    assert plan.controls.shape == (1, STEPS, 2)


def test_a_model_that_takes_no_acceleration_commands_none():
    """Its first control, a velocity, is well above what the limit would let an acceleration be."""

    def gentle(motion, acceleration, problems):
        return acceleration.unsqueeze(-1) - 0.1

    def plan(constraints):
        model = Holonomic(load_vehicle("wheelchair"), 0.25)
        parts = weighted_cost(), ILQR(max_iterations=60), DetourFan(), STEPS
        return MPCPlanner(model, *parts, constraints=constraints)(problem(1))

    free, limited = plan(None), plan(PlanConstraints({"gentle": gentle}))
    assert (free.controls[..., 0] > 1).any()
    assert torch.equal(limited.controls, free.controls)


def test_another_optimiser_cannot_keep_to_limits():
    planner = training()
    arguments = {"constraints": PlanConstraints(LIMITS), "solver": print}
    with pytest.raises(TypeError, match="`solver` must be an ILQR"):
        type(planner)(planner.dynamics, planner.cost, candidates=planner.candidates, **arguments)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("linear", -1.0),
        ("linear", float("nan")),
        ("max_iterations", 0),
        ("max_iterations", 2.5),
        ("tolerance", 0.0),
    ],
)
def test_settings_that_no_solver_takes_are_refused_where_they_are_given(name, value):
    with pytest.raises(ValueError, match=f"`{name}` must be"):
        PlanConstraints(LIMITS, **{name: value})
