"""The fan of detours."""

from dataclasses import fields

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3, DiffKBM, ExtendedUnicycle, Holonomic, ReversingFloor
from diffstack_mmv.planning import DetourFan, Pursuit, Reference, build_problem
from diffstack_mmv.planning.detours import Detour, backing_detours, drawn_detours
from diffstack_mmv.planning.pursuit import Leg
from diffstack_mmv.simulation.zero_order_hold import ZeroOrderHold
from diffstack_mmv.types import Discs, Ego, HeadingOf, Motion, Obstacles, map_tensors
from diffstack_mmv.vehicles import load_vehicle


def problem(speed=2.0, goal=(5.0, 0.0)):
    motion = Motion(torch.zeros(1, 2), torch.zeros(1), torch.tensor([[speed, 0.0]]), torch.zeros(1))
    nobody = Obstacles(
        torch.zeros(1, 0, 1, 13, 2), torch.ones(1, 0, 1), torch.ones(1, 0), torch.ones(1, 0) > 0
    )
    target = torch.tensor([goal])
    ego = Ego(motion, HeadingOf.BODY, Discs(torch.zeros(1, 1), torch.full((1, 1), 0.3)))
    return build_problem(ego, target, Reference(torch.zeros(1, 13, 2), torch.tensor([3.0])), nobody)


@pytest.fixture(params=[DiffKBM, DiffGM3])
def model(request):
    return request.param(load_vehicle("bicycle"), dt_s=0.25)


@pytest.fixture(params=["unicycle", "bicycle"])
def reversing(request):
    if request.param == "unicycle":
        return ExtendedUnicycle(load_vehicle("wheelchair"), dt_s=0.25)
    return ZeroOrderHold(DiffKBM(load_vehicle("bicycle"), 0.05, ReversingFloor(1.0)), 5)


@pytest.fixture
def fan(model):
    with torch.no_grad():
        return DetourFan()(model, problem(), 12), model


def test_all_controls_are_admissible(fan):
    candidates, model = fan
    assert torch.equal(model.within_bounds(candidates.controls), candidates.controls)


def test_the_last_candidate_brakes_to_a_stop(fan):
    candidates, _ = fan
    assert float(candidates.motion.velocity[0, -1, -1, 0].abs()) < 0.05
    assert float(candidates.motion.position[0, -1, -1, 0]) < 1.2
    assert float(candidates.motion.position[0, -1, :, 1].abs().max()) < 1e-5  # straight on


@pytest.mark.parametrize("speed", [2.0, -0.8])
def test_who_can_reverse_brakes_to_a_stop_and_stays(reversing, speed):
    with torch.no_grad():
        braking = DetourFan()(reversing, problem(speed=speed), 12).motion.velocity[0, -1, :, 0]
    assert float(braking[0]) == pytest.approx(speed)
    assert float(braking[-6:].abs().max()) < 1e-5
    assert float((braking * speed).min()) > -1e-5
    hardest = -reversing.bounds.lower[list(reversing.Control._fields).index("acceleration")]
    if speed > 0:
        assert float(braking[0] - braking[1]) == pytest.approx(0.25 * float(hardest), rel=1e-4)


def test_backing_candidates_come_beside_the_others_and_go_back(reversing):
    with torch.no_grad():
        plain = DetourFan(drawn=8)(reversing, problem(speed=0.0), 28)
        more = DetourFan(drawn=8, backing=32)(reversing, problem(speed=0.0), 28)
    assert more.controls.shape[1] == plain.controls.shape[1] + 32
    assert torch.equal(more.motion.position[:, :116], plain.motion.position[:, :116])
    assert torch.equal(more.motion.position[:, -1], plain.motion.position[:, -1])
    backing = Motion(*(field[0, 116:-1] for field in more.motion))
    speed = backing.velocity[..., 0]
    assert float(plain.motion.velocity[..., 0].min()) > -1e-5
    assert -1.0 - 1e-5 < float(speed.min()) < -0.9
    assert bool((speed.amin(-1) < -0.1).sum() > 20)
    assert float(backing.position[..., 0].min()) < -1.0
    assert bool((speed[:, -1] > 0.5).any())
    assert torch.equal(reversing.within_bounds(more.controls), more.controls)


def test_a_course_that_is_backed_along_is_found(reversing):
    fan = DetourFan(backing=1)
    fan.detour = Detour(torch.full((1, 2), 2.0), torch.full((1, 2), -0.33), torch.full((1, 2), 5.0))
    with torch.no_grad():
        backing = fan(reversing, problem(speed=0.0, goal=(500.0, 0.0)), 20).motion
    step = backing.position[0, 0, -1] - backing.position[0, 0, -2]
    assert float(torch.atan2(step[1], step[0])) == pytest.approx(2.0, abs=0.1)
    assert float(backing.velocity[0, 0, -1, 0]) == pytest.approx(-0.99, abs=0.01)


def test_only_who_can_reverse_begins_backwards(model):
    with pytest.raises(ValueError, match="`dynamics` must be able to reverse"):
        DetourFan(backing=4)(model, problem(), 12)


def test_who_takes_any_velocity_at_once_arrives_and_stops():
    model = Holonomic(load_vehicle("wheelchair"), dt_s=0.25)
    with torch.no_grad():
        fan = DetourFan()(model, problem(goal=(-3.0, 1.0)), 12)
        library = DetourFan(compile=True)(model, problem(goal=(-3.0, 1.0)), 12)
    distance = (fan.motion.position - torch.tensor([-3.0, 1.0])).norm(dim=-1)
    assert float(distance.min()) < 0.1
    assert float(fan.motion.velocity[0, -1, 1:, 0].abs().max()) < 1e-3
    torch.testing.assert_close(library.states, fan.states, rtol=1e-4, atol=1e-4)


def test_one_candidate_arrives(fan):
    candidates, _ = fan
    distance = (candidates.motion.position - torch.tensor([5.0, 0.0])).norm(dim=-1)
    assert float(distance.min()) < 0.25


def test_courses_are_mirrored(fan):
    candidates, _ = fan
    lateral = candidates.motion.position[0, :-1, 5, 1].reshape(9, -1)
    assert torch.allclose(lateral, -lateral.flip(0), atol=1e-3)


def test_a_goal_beside_a_fast_vehicle_is_not_circled(model):
    with torch.no_grad():
        fan = DetourFan()(model, problem(speed=2.9, goal=(0.5, 2.0)), 20)
    distance = (fan.motion.position - torch.tensor([0.5, 2.0])).norm(dim=-1)
    assert float(distance.min()) < 0.3


def test_drawn_candidates_come_beside_the_others_and_some_lead_back(model):
    with torch.no_grad():
        plain = DetourFan()(model, problem(), 20)
        more = DetourFan(drawn=64)(model, problem(), 20)
    assert more.controls.shape[1] == plain.controls.shape[1] + 64
    before, now = plain.motion.position, more.motion.position
    assert torch.allclose(now[:, :108], before[:, :108], atol=1e-3)
    assert torch.allclose(now[:, -1], before[:, -1], atol=1e-3)
    assert torch.equal(model.within_bounds(more.controls), more.controls)
    drawn = more.motion.position[0, 108:-1]
    assert float(drawn[:, 14, 0].min()) < 0 < 3.0 < float(drawn[:, 14, 0].max())


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("offsets_deg", ()),
        ("speed_shares", (1.5,)),
        ("drawn", -1),
        ("drawn", 2.5),
        ("backing", -1),
        ("backing", 1.0),
        ("drawn_until_s", 0.0),
    ],
)
def test_numbers_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        DetourFan(**{name: value})


@pytest.mark.parametrize("name", [field.name for field in fields(Pursuit)])
def test_a_pursuit_at_no_speed_or_in_no_time_is_refused(name):
    with pytest.raises(ValueError, match=name):
        Pursuit(**{name: 0.0})


def test_a_fan_is_driven_by_the_pursuit_that_it_is_given(model):
    slow = DetourFan(pursuit=Pursuit(braking_mps2=0.1))
    with torch.no_grad():
        fastest = [
            fan(model, problem(), 12).motion.velocity[..., 1:, 0].max()
            for fan in (DetourFan(), slow)
        ]
    assert float(fastest[1]) < float(fastest[0]) - 0.5


def test_the_library_drives_the_same_fan(model):
    same_in_the_library(model, drawn=3)


def test_the_library_drives_backwards_as_well(reversing):
    same_in_the_library(reversing, drawn=3, backing=5)


def same_in_the_library(model, **settings):
    with torch.no_grad():
        expected = DetourFan(**settings)(model, problem(), 12)
        found = DetourFan(compile=True, **settings)(model, problem(), 12)
    torch.testing.assert_close(found.states, expected.states, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(found.controls, expected.controls, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(found.motion, expected.motion, rtol=1e-3, atol=1e-3)


def test_a_fan_that_was_used_before_is_as_good_as_new():
    """It keeps what its candidates do in each step, for each horizon, precision and device."""
    used = DetourFan(drawn=3)
    for dtype in (torch.float32, torch.float64, torch.float32):
        model = DiffKBM(load_vehicle("bicycle"), dt_s=0.25).to(dtype)
        given = map_tensors(lambda e: e.to(dtype) if e.is_floating_point() else e, problem())  # noqa: B023
        with torch.no_grad():
            for steps in (12, 6):
                expected = DetourFan(drawn=3)(model, given, steps)
                assert torch.equal(used(model, given, steps).states, expected.states)


def arc(pursuit, speed, leg, goal):
    """What a wheelchair at the origin, heading along x at this speed in m/s, is asked for."""
    model = ExtendedUnicycle(load_vehicle("wheelchair"), dt_s=0.25)
    state, target = torch.tensor([[0.0, 0.0, 0.0, speed]]), torch.tensor([goal])
    return pursuit.arc(model, state, leg, target, torch.tensor([9.0]))


def leg(offset, share, detours):
    return Leg(torch.tensor([offset]), torch.tensor([share]), torch.tensor([detours]))


def test_who_still_rolls_forward_steers_for_the_way_back_already():
    """So does who rolls backwards, by the same angle; both are below the speed that counts."""
    back = leg(2.5, -0.8, True)
    still, backwards = (arc(Pursuit(), speed, back, (5.0, 0.0)) for speed in (0.2, -0.2))
    assert float(still.curvature) == float(backwards.curvature) != 0


@pytest.mark.parametrize(("yaw_rate", "speed"), [(2.0, 2.0), (0.5, 0.5), (0.1, 0.3)])
def test_a_turn_to_the_goal_is_as_slow_as_its_yaw_rate_asks(yaw_rate, speed):
    """On an arc of radius 1 m, but never slower than creeping."""
    pursuit = Pursuit(lateral_mps2=1e3, braking_mps2=1e3, yaw_rate_radps=yaw_rate)
    asked = arc(pursuit, 1.0, leg(0.0, 1.0, False), (1.0, 1.0))
    assert float(asked.acceleration) == pytest.approx((speed - 1.0) / 0.25, rel=1e-5)


def test_no_backing_leg_is_slow():
    first = backing_detours(16, 4.0).speed_share[:, 0]
    assert -1 <= float(first.min()) < float(first.max()) <= -0.5


@pytest.mark.parametrize("number", [0, 1])
def test_each_problem_of_a_batch_has_the_fan_to_its_own_goal(number):
    def alone(record):
        return map_tensors(lambda entry: entry[number, None], record)

    both = map_tensors(lambda entry: torch.cat([entry, entry]), problem())
    both.goal[1], both.reference_speed[1] = torch.tensor([-1.0, 2.0]), 2.0
    both.ego.motion.velocity[1, 0] = 1.0
    model, fan = ExtendedUnicycle(load_vehicle("wheelchair"), dt_s=0.25), DetourFan(drawn=2)
    found, expected = alone(fan(model, both, 6)), fan(model, alone(both), 6)
    torch.testing.assert_close(found.motion, expected.motion)
    torch.testing.assert_close(found.controls, expected.controls)


def test_legs_follow_each_other_and_then_the_goal_is_made_for():
    detour = Detour(*torch.tensor([[[1.0, -2.0]], [[0.2, 0.8]], [[0.5, 1.0]]]))
    driven, braking = DetourFan()._scheduled(detour, 6, 0.25)
    offset, share, detours, brakes = driven.T.tolist()
    assert offset[:4] == [1.0, 1.0, -2.0, -2.0]
    assert share[:4] == pytest.approx([0.2, 0.2, 0.8, 0.8])
    assert detours == [1, 1, 1, 1, 0, 0]
    assert brakes == [0] * 6
    assert braking[:, -1].tolist() == [1] * 6


def test_drawn_legs_go_anywhere_and_wait_or_flee_in_a_sixth_each():
    drawn = drawn_detours(1023, 4.0)
    assert drawn.offset.mean(0).abs().max() < 0.05
    assert drawn.offset.abs().amax(0).tolist() == pytest.approx([torch.pi] * 2, abs=0.01)
    for share in (0, 1):
        waiting = (drawn.speed_share == share).double().mean(0)
        assert waiting.tolist() == pytest.approx([1 / 6] * 2, abs=0.01)
    assert (drawn.until.diff() >= 0).all()
    assert 3.9 < float(drawn.until.max()) <= 4.0
