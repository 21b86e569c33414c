"""Coordinates of the controls: plans that brake to rest."""

import pytest
import torch

from diffstack_mmv.control import ILQR
from diffstack_mmv.control.native.scan import scan
from diffstack_mmv.dynamics import DiffKBM, ExtendedUnicycle, SoftplusFloor, rollout
from diffstack_mmv.planning import AccelerationShares, PhysicalControls, above_rest
from diffstack_mmv.simulation import ZeroOrderHold
from diffstack_mmv.types import map_tensors
from diffstack_mmv.vehicles import load_vehicle
from tests.planning.test_planner import problem, training

SPEEDS = torch.tensor([0.0, 0.15, 0.5, 1.2])
TOP_MPS = 2.4
LEFT_M = torch.tensor([-0.05, 0.02, 0.05, 0.3])


def kbm():
    return DiffKBM(load_vehicle("bicycle"), dt_s=0.25)


def braking(shift_m=0.0):
    """Egos that are almost at their goals, some of which they cannot but overrun."""
    problems = map_tensors(lambda e: e.double() if e.is_floating_point() else e, problem())
    problems.ego.motion.velocity[:, 0] = SPEEDS.double()
    problems.goal[:, 0] = LEFT_M.double() + shift_m
    problems.goal[:, 1] = 0.03
    return problems


def planner(coordinates):
    made = training(coordinates=coordinates).double()
    made.solver = ILQR(max_iterations=60, tolerance=1e-10)
    return made


def test_a_step_with_the_acceleration_to_rest_ends_at_rest():
    model = kbm()
    state = torch.nn.functional.pad(SPEEDS.unsqueeze(-1), (3, 0))
    rest = model.useful_acceleration(state).least
    after = model.step(state[:2], torch.nn.functional.pad(rest[:2, None], (0, 1)))
    assert after[:, 3].abs().max() < 1e-6


@pytest.mark.parametrize(
    ("model", "kind"),
    [
        (kbm(), AccelerationShares),
        (DiffKBM(load_vehicle("bicycle"), floor=SoftplusFloor()), PhysicalControls),
        (ExtendedUnicycle(load_vehicle("bicycle")), PhysicalControls),
    ],
)
def test_only_a_model_with_a_kink_at_rest_gets_other_coordinates(model, kind):
    assert isinstance(above_rest(model), kind)


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_a_share_is_one_of_the_way_from_stopping_within_the_step_to_the_limit(share):
    model = kbm()
    least, most = (float(bound[0]) for bound in model.bounds)
    speed = torch.tensor([0.0, 0.5, 8.0])
    states = torch.nn.functional.pad(speed.unsqueeze(-1), (3, 0))
    found = AccelerationShares(model).controls(states, torch.tensor([share, 0.1]).expand(3, 2))
    rest = [max(least, -each / 0.25) for each in speed.tolist()]
    expected = [each + share * (most - each) for each in rest]
    assert found[:, 0].tolist() == pytest.approx(expected, abs=1e-4)
    assert found[:, 1].tolist() == pytest.approx([0.1] * 3)


def test_the_box_of_shares_is_that_of_the_controls_but_for_the_acceleration():
    model = kbm()
    before = map_tensors(torch.clone, model.bounds)
    box = AccelerationShares(model).bounds
    assert (float(box.lower[0]), float(box.upper[0])) == (0.0, 1.0)
    assert (box.lower[1], box.upper[1]) == (before.lower[1], before.upper[1])
    assert torch.equal(model.bounds.lower, before.lower)
    assert torch.equal(model.bounds.upper, before.upper)


@pytest.mark.parametrize(("acceleration", "share"), [(99.0, 1.0), (-99.0, 0.0)])
def test_controls_beyond_the_limits_are_shares_at_them(acceleration, share):
    controls = torch.tensor([acceleration, 0.0]).expand(4, 3, 2)
    start = torch.nn.functional.pad(SPEEDS.unsqueeze(-1), (3, 0))
    found = AccelerationShares(kbm()).coordinates(start, controls)
    assert (found[..., 0] == share).all()


def test_beyond_the_end_of_a_plan_its_controls_are_zero():
    coordinates = AccelerationShares(kbm())
    states, shares = torch.rand(3, 5, 4), torch.rand(3, 5, 2)
    padded = coordinates.padded_controls(states, shares)
    assert torch.equal(padded[:, :-1], coordinates.controls(states, shares)[:, :-1])
    assert (padded[:, -1] == 0).all()
    assert (padded[:, :-1] != 0).all()


def test_coordinates_and_controls_are_each_others_inverse_but_for_braking_beyond_rest():
    generator = torch.Generator().manual_seed(0)
    coordinates, model = AccelerationShares(kbm().double()), kbm().double()
    start = torch.nn.functional.pad(SPEEDS.double().unsqueeze(-1), (3, 0))
    controls = torch.rand(4, 10, 2, generator=generator, dtype=torch.double) - 0.6
    states = rollout(model, start, controls)
    shares = coordinates.coordinates(start, controls)
    again = coordinates.controls(states[:, :-1], shares)
    assert torch.allclose(rollout(model, start, again), states, atol=1e-5)
    beyond = controls[..., 0] < model.useful_acceleration(states[:, :-1]).least
    assert beyond.any()
    assert torch.allclose(again[~beyond], controls[~beyond], atol=1e-4)


def test_a_library_finds_the_same_coordinates():
    coordinates = AccelerationShares(kbm())
    start = torch.nn.functional.pad(SPEEDS.unsqueeze(-1), (3, 0))
    controls = torch.rand(4, 10, 2, generator=torch.Generator().manual_seed(0)) - 0.6
    found = coordinates.coordinates(start, controls, compile=True)
    assert scan(coordinates._told, start, controls, [coordinates.dynamics]) is not None
    torch.testing.assert_close(found, coordinates.coordinates(start, controls))


def test_plans_that_brake_to_rest_are_solved_and_cost_no_more():
    problems = braking()
    with torch.no_grad():
        shares, physical = (planner(kind)(problems) for kind in (above_rest, PhysicalControls))
    assert shares.converged.all()
    assert (shares.motion.velocity[..., 0] >= 0).all()
    assert (shares.motion.velocity[..., -1, 0] < 1e-3).any()
    assert (shares.solution.cost <= physical.solution.cost * (1 + 1e-5)).all()
    assert shares.solution.iterations.max() < 25


def test_their_gradient_is_that_of_differences():
    made, step = planner(above_rest), 1e-5
    problems = braking()
    goal = problems.goal.requires_grad_()
    plan = made(problems)
    plan.motion.position[..., -1, 0].sum().backward()
    with torch.no_grad():
        ends = [made(braking(shift)).motion.position[..., -1, 0] for shift in (step, -step)]
    difference = (ends[0] - ends[1]) / (2 * step)
    assert torch.allclose(goal.grad[:, 0], difference, atol=1e-3)


def governed(kind):
    """A planner of a vehicle that is governed to 2.4 m/s, in steps of 0.05 s."""
    made = planner(kind)
    model = DiffKBM(load_vehicle("bicycle"), dt_s=0.05)
    made.dynamics = ZeroOrderHold(model, 5, speed_max_mps=TOP_MPS).double()
    return made


def hurrying(shift_m=0.0):
    """Egos at and below their top speed whose goals are further than they come."""
    problems = map_tensors(lambda e: e.double() if e.is_floating_point() else e, problem())
    problems.ego.motion.velocity[:, 0] = torch.tensor([1.5, 2.0, 2.39, TOP_MPS], dtype=torch.double)
    problems.goal[:, 0] = 9.0
    problems.goal[:, 1] += shift_m
    return problems


def test_plans_at_the_top_speed_are_solved_and_have_the_gradient_of_differences():
    """With the controls themselves they end on a kink, and both derivatives are wrong."""
    made, step = governed(above_rest), 1e-5
    problems = hurrying()
    goal = problems.goal.requires_grad_()
    plan = made(problems)
    speed = plan.motion.velocity[..., 0]
    assert plan.converged.all()
    assert ((speed - TOP_MPS).abs() < 1e-4).any(-1).all()
    assert (speed <= TOP_MPS + 1e-9).all()
    assert plan.solution.iterations.max() < 25
    with torch.no_grad():
        ahead, behind = (made(hurrying(shift)).motion for shift in (step, -step))
    for name, column in (("position", 1), ("velocity", 0)):
        row = (..., 3, column)
        (slope,) = torch.autograd.grad(getattr(plan.motion, name)[row].sum(), goal, None, True)
        told = (getattr(ahead, name)[row] - getattr(behind, name)[row]) / (2 * step)
        assert torch.allclose(slope[:, 1], told, atol=1e-5)
        assert name == "velocity" or (told.abs() > 1e-3).all()


def test_who_speeds_up_no_harder_than_to_the_top_loses_part_of_a_step():
    with torch.no_grad():
        shares, physical = (governed(each)(hurrying()) for each in (above_rest, PhysicalControls))
    assert (shares.solution.cost <= physical.solution.cost * 1.01).all()
    assert (shares.solution.iterations < physical.solution.iterations).all()
