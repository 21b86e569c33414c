"""The fan of candidates is feasible, covers its lattice, and reaches the goal."""

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3, DiffKBM, ExtendedUnicycle, rollout
from diffstack_mmv.geometry import rotate
from diffstack_mmv.planning import CandidateFan, closest_candidate, cross_entropy
from diffstack_mmv.planning.problem import observed_obstacles
from diffstack_mmv.types import Motion, map_tensors
from diffstack_mmv.vehicles import load_vehicle
from tests.planning.test_problem import problem_of, tracks

SPEC = load_vehicle("bicycle")
each_model = pytest.mark.parametrize(
    "model", [ExtendedUnicycle(SPEC), DiffKBM(SPEC)], ids=["unicycle", "kbm"]
)


def problem(speed=4.0, goal=(11.0, 2.0)):
    none = observed_obstacles(tracks(1, 0, rows=2), tracks(1, 0, rows=30))
    made = problem_of(tracks(1, rows=2), torch.zeros(1, 30, 2), torch.tensor([goal]), none)
    velocity = torch.tensor([[speed, 0.0]])
    motion = Motion(torch.zeros(1, 2), torch.zeros(1), velocity, torch.zeros(1))
    return made._replace(ego=made.ego._replace(motion=motion))


@each_model
def test_every_candidate_is_the_motion_of_the_model_within_its_bounds(model):
    fan = CandidateFan()(model, problem(), 30)
    again = rollout(model, fan.states[..., 0, :], fan.controls)
    lower, upper = model.bounds
    assert fan.controls.shape[-3:] == (64, 30, 2)
    assert torch.allclose(again, fan.states, atol=1e-5)
    assert (fan.controls >= lower).all()
    assert (fan.controls <= upper).all()


@each_model
def test_straight_ahead_at_constant_speed_is_among_the_candidates(model):
    ends = CandidateFan()(model, problem(), 30).motion.position[0, :, -1]
    assert (ends - torch.tensor([12.0, 0.0])).norm(dim=-1).min() < 1e-3


@pytest.mark.parametrize(("speeds", "offsets"), [(1, 1), (1, 3), (3, 1), (5, 9)])
def test_an_odd_number_of_speeds_and_offsets_keeps_the_present_motion(speeds, offsets):
    lattice = CandidateFan(speeds, offsets)(ExtendedUnicycle(SPEC), problem(), 30).states[0, :-1]
    middle = lattice[len(lattice) // 2, -1]
    torch.testing.assert_close(middle, torch.tensor([12.0, 0.0, 0.0, 4.0]))
    torch.testing.assert_close(lattice.flip(0)[:, -1, 2], -lattice[:, -1, 2])


@each_model
@pytest.mark.parametrize("goal", [(11.0, 2.0), (12.0, -4.0), (14.0, 0.0)])
def test_one_candidate_ends_near_the_goal(model, goal):
    ends = CandidateFan()(model, problem(goal=goal), 30).motion.position[0, -1, -1]
    assert (ends - torch.tensor(goal)).norm() < 0.3


def test_the_fans_of_turned_and_moved_problems_are_turned_and_moved():
    model = ExtendedUnicycle(SPEC)
    straight = CandidateFan()(model, problem(goal=(11.0, 4.0)), 30).motion
    angle, away = torch.tensor([2.2, -0.7]), torch.tensor([[3.0, -8.0], [-1.0, 5.0]])
    one = problem(goal=(11.0, 4.0))
    both = map_tensors(lambda entry: entry.repeat(2, *[1] * (entry.dim() - 1)), one)
    motion = both.ego.motion._replace(position=away, heading=angle)
    goal = rotate(both.goal, angle) + away
    turned = both._replace(ego=both.ego._replace(motion=motion), goal=goal)
    fan = CandidateFan()(model, turned, 30).motion
    expected = rotate(straight.position, angle[:, None, None]) + away[:, None, None]
    torch.testing.assert_close(fan.position, expected, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(fan.velocity, straight.velocity.expand_as(fan.velocity))


@each_model
@pytest.mark.parametrize("goal", [(0.0, 0.0), (-3.0, 0.0), (0.0, 2.0)])
def test_fan_is_finite_at_standstill_and_with_the_goal_anywhere(model, goal):
    fan = CandidateFan()(model, problem(speed=0.0, goal=goal), 30)
    assert torch.isfinite(fan.states).all()


FAST = [("motorcycle", 14.0), ("motorcycle", 20.0), ("bicycle", 8.0), ("scooter", 5.0)]
GOALS = [(8.0, 1.0), (8.0, 4.0), (25.0, 12.0), (-5.0, 0.5), (30.0, -20.0), (3.0, -3.0), (0.0, 2.0)]


@pytest.mark.parametrize(("vehicle", "speed"), FAST)
@pytest.mark.parametrize("goal", GOALS)
def test_no_candidate_spins_or_rolls_backwards(vehicle, speed, goal):
    model = DiffGM3(load_vehicle(vehicle))
    motion = CandidateFan()(model, problem(speed, goal), 30).motion
    assert motion.yaw_rate.abs().max() < 3.0
    assert motion.velocity[..., 0].min() > -0.1


def test_whoever_is_faster_than_the_fan_need_not_brake():
    fan = CandidateFan(speed_max_mps=12.0)(DiffKBM(SPEC), problem(14.0, (40.0, 0.0)), 30)
    ends = fan.motion.velocity[0, :, -1, 0].detach()
    assert ends.max() == pytest.approx(14.0)


@pytest.mark.slow
def test_a_library_holds_the_tyres_as_tensors_do():
    model = DiffGM3(load_vehicle("motorcycle")).double()
    given = map_tensors(lambda field: field.double(), problem(14.0, (8.0, 1.0)))
    fans = [CandidateFan(compile=compile)(model, given, 30) for compile in (False, True)]
    torch.testing.assert_close(fans[0].states, fans[1].states, atol=1e-9, rtol=1e-9)


def test_closest_candidate_is_judged_at_valid_times_only():
    positions = torch.zeros(1, 2, 3, 2)
    positions[0, 0, 2] = 100.0
    positions[0, 1] = 1.0
    human = torch.zeros(1, 3, 2)
    valid = torch.tensor([[True, True, False]])
    assert closest_candidate(positions, human, valid).item() == 0
    assert closest_candidate(positions, human, torch.ones_like(valid)).item() == 1


def test_cross_entropy_is_that_of_torch():
    logits, target = torch.randn(5, 7), torch.randint(7, (5,))
    expected = torch.nn.functional.cross_entropy(logits, target, reduction="none")
    assert torch.allclose(cross_entropy(logits, target), expected)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "arguments",
    [
        {"speeds": 0},
        {"offsets": 0},
        {"speeds": 2.5},
        {"offsets": 3.0},
        {"speed_change_mps": 0.0},
        {"offset_share": -1.0},
        {"speed_max_mps": 0.0},
    ],
)
def test_impossible_fans_are_refused(arguments):
    with pytest.raises(ValueError, match=next(iter(arguments))):
        CandidateFan(**arguments)
