"""Longer control steps, and another point of the body."""

import copy
import dataclasses

import pytest
import torch

from diffstack_mmv.dynamics import SoftplusFloor, rollout
from diffstack_mmv.dynamics.catalogue import dynamics_names, model_of
from diffstack_mmv.dynamics.gm3 import DiffGM3WheelSpeed
from diffstack_mmv.dynamics.kbm import DiffKBM
from diffstack_mmv.simulation import ZeroOrderHold
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import load_vehicle


@pytest.fixture(params=["kbm", "gm3"])
def inner(request):
    return model_of("bicycle", request.param, 0.05)


def test_one_held_step_is_many_steps(inner):
    state = inner.initial_state(turning())
    control = torch.tensor([[1.0, 0.2]])
    expected = inner(inner(inner(state, control), control), control)
    assert torch.equal(ZeroOrderHold(inner, 3)(state, control), expected)


def test_the_step_and_the_columns_are_told(inner):
    held = ZeroOrderHold(inner, 5)
    assert held.dt_s == pytest.approx(0.25)
    assert held.State is inner.State
    assert held.state_dim == inner.state_dim


def test_a_model_is_described_by_itself_however_long_it_is_held(inner):
    held = ZeroOrderHold(inner, 3)
    assert held.description() == inner.description()
    assert held.derived_quantities().keys() == inner.derived_quantities().keys()


def turning():
    """A vehicle that turns left at 2 m/s."""
    return Motion(
        torch.tensor([[1.0, 2.0]]),
        torch.tensor([0.3]),
        torch.tensor([[2.0, 0.1]]),
        torch.tensor([0.4]),
    )


def test_a_point_ahead_moves_sideways_in_a_turn():
    held = ZeroOrderHold(model_of("bicycle", "gm3", 0.05), 1, ahead_m=-0.45)
    state = held.initial_state(turning())
    back = held.motion(state, torch.zeros(1, 2))
    for found, expected in zip(back, turning(), strict=True):
        assert torch.allclose(found, expected, atol=1e-6)
    behind = held.model.motion(state, torch.zeros(1, 2))
    offset = behind.position - turning().position
    heading = torch.tensor([[0.3]])
    assert torch.allclose(offset, 0.45 * torch.cat([heading.cos(), heading.sin()], -1), atol=1e-6)


@pytest.mark.parametrize(("name", "ahead_m"), [("kbm", 0.5), ("gm3", -0.45)])
def test_a_state_on_course_has_the_point_where_it_was_asked_for(name, ahead_m):
    model = model_of("bicycle", name, 0.05)
    held = ZeroOrderHold(model, 2, ahead_m)
    straight = turning()._replace(velocity=torch.tensor([[2.0, 0.0]]), yaw_rate=torch.zeros(1))
    found = held.motion(held.state_on_course(straight), torch.zeros(1, 2))
    assert torch.allclose(found.position, straight.position, atol=1e-6)
    assert torch.allclose(found.heading, straight.heading)
    assert held.reference_ahead_m == pytest.approx(model.reference_ahead_m + ahead_m)


def test_no_step_is_refused(inner):
    with pytest.raises(ValueError, match="repeats"):
        ZeroOrderHold(inner, 0)


@pytest.fixture(params=[("bicycle", "kbm"), ("wheelchair", "gm3"), ("bicycle", "kbm_reversing")])
def governed(request):
    return ZeroOrderHold(model_of(*request.param, 0.05).double(), 5, speed_max_mps=1.0)


def commands(model, at, acceleration=None):
    """States of speeds `at` (m/s), and controls of an acceleration, the hardest by default."""
    speed = torch.tensor(at, dtype=torch.double)
    zero = torch.zeros_like(speed)
    flat = torch.stack([zero, zero], -1)
    state = model.initial_state(Motion(flat, zero, torch.stack([speed, zero], -1), zero))
    control = torch.stack([zero + model.bounds.upper[0], zero], -1)
    if acceleration is not None:
        control[..., 0] = acceleration
    return state, control


def speed_of(model, state):
    """Forward speed in m/s."""
    return model.motion(state, torch.zeros(*state.shape[:-1], 2).to(state)).velocity[..., 0]


def test_the_drive_pushes_no_further_than_to_the_top_speed(governed):
    state, control = commands(governed, (0.0, 0.7, 0.95, 1.0))
    after = speed_of(governed, governed(state, control)).detach()
    assert after.max() < 1.005
    assert after[0] > 0.3
    assert after[1:] == pytest.approx(torch.ones(3), abs=0.005)


def test_below_the_top_speed_nothing_is_changed(governed):
    state, control = commands(governed, (0.2, 0.5), acceleration=0.8)
    plain = ZeroOrderHold(governed.model, governed.repeats)
    assert torch.equal(governed(state, control), plain(state, control))


@pytest.mark.parametrize("speed_max_mps", [0.0, -1.0])
def test_a_top_speed_is_positive(inner, speed_max_mps):
    with pytest.raises(ValueError, match="`speed_max_mps` must be positive"):
        ZeroOrderHold(inner, 5, speed_max_mps=speed_max_mps)


def test_a_top_speed_needs_an_acceleration_to_govern():
    with pytest.raises(ValueError, match=r"`controls` must contain acceleration.*top speed needs"):
        ZeroOrderHold(model_of("bicycle", "holonomic", 0.05), 5, speed_max_mps=1.0)


MODELS = {
    **{
        name: lambda step_s, name=name: model_of("bicycle", name, step_s)
        for name in dynamics_names()
    },
    "wheel_speed": lambda step_s: DiffGM3WheelSpeed(load_vehicle("bicycle"), step_s),
}


def going(model, at):
    """States of speeds `at` (m/s), straight ahead."""
    speed = torch.tensor(at, dtype=torch.double)
    zero = torch.zeros_like(speed)
    flat = torch.stack([zero, zero], -1)
    return model.initial_state(Motion(flat, zero, torch.stack([speed, zero], -1), zero))


def faster(model, state, control):
    """Mean acceleration (m/s²) over a control step."""
    ends = [model.motion(each, control).velocity[..., 0] for each in (state, model(state, control))]
    return ((ends[1] - ends[0]) / model.dt_s).detach()


@pytest.mark.parametrize("name", MODELS)
def test_the_acceleration_over_the_hold_is_the_one_that_was_asked_for(name):
    held = ZeroOrderHold(MODELS[name](0.05).double(), 5)
    state = going(held, (2.0, 3.0))
    for asked in (-1.0, 0.0, 0.8):
        wanted = torch.full((2,), asked).double()
        control = held.control_for(state, wanted, torch.zeros_like(wanted))
        assert torch.allclose(faster(held, state, control), wanted, atol=0.05)


@pytest.mark.parametrize("name", ["holonomic", "unicycle"])
def test_the_turn_over_the_hold_is_the_one_that_was_asked_for(name):
    held = ZeroOrderHold(MODELS[name](0.05).double(), 5)
    state, wanted = going(held, (2.0,)), torch.tensor([0.4]).double()
    control = held.control_for(state, 0.5 + torch.zeros_like(wanted), wanted)
    turned = held(state, control)[..., 2] - state[..., 2]
    assert torch.allclose(turned, wanted * 0.25 * (2.0 + 0.0625), atol=0.01)


@pytest.mark.parametrize("name", ["holonomic", "kbm_reversing", "wheel_speed"])
def test_the_hardest_braking_that_only_stops_ends_at_rest(name):
    held = ZeroOrderHold(MODELS[name](0.05).double(), 5)
    state = going(held, (0.4,))
    braking = held.hardest_braking(state)
    control = held.control_for(state, braking, torch.zeros_like(braking))
    assert held.motion(held(state, control), control).velocity[..., 0].abs() < 0.02


@pytest.mark.parametrize(("share", "stopped"), [(1.0, True), (0.9, False)])
def test_the_least_useful_acceleration_stops_at_the_end_of_the_hold(share, stopped):
    held = ZeroOrderHold(MODELS["kbm"](0.05).double(), 5)
    state = going(held, (0.2, 0.5))
    rest = share * held.useful_acceleration(state).least
    states = rollout(held, state, torch.stack([rest, 0 * rest], -1)[:, None])
    assert bool((states[:, -1, 3].abs() < 1e-12).all()) == stopped


@pytest.mark.parametrize("name", ["kbm", "unicycle", "gm3"])
@pytest.mark.parametrize(("share", "slower"), [(1.0, False), (0.9, True)])
def test_the_most_useful_acceleration_reaches_the_top_speed_at_the_end_of_the_hold(
    name, share, slower
):
    held = ZeroOrderHold(MODELS[name](0.05).double(), 5, speed_max_mps=2.0)
    free = ZeroOrderHold(held.model, 5)
    state = going(held, (1.8, 1.9))
    control = torch.zeros(2, held.control_dim).double()
    names = list(held.Control._fields)
    control[:, names.index("acceleration")] = share * held.useful_acceleration(state).most
    after = rollout(held, state, control[:, None])
    # up to it the governor is not in the way
    assert torch.allclose(after, rollout(free, state, control[:, None]), atol=1e-12)
    speed = held.motion(after, torch.zeros(2, 2, held.control_dim).double()).velocity[:, -1, 0]
    reach = {"kbm": 1e-12, "unicycle": 1e-12, "gm3": 5e-3}[name]
    assert bool((speed < 2.0 - 5e-3).all()) == slower
    assert slower or bool(((speed - 2.0).abs() <= reach).all())


def test_a_governed_vehicle_that_reverses_is_bounded_on_both_sides():
    spec = dataclasses.replace(load_vehicle("bicycle"), reverse=True)
    held = ZeroOrderHold(DiffKBM(spec, 0.05).double(), 5, speed_max_mps=1.5)
    least, most = held.useful_acceleration(going(held, (0.5, -1.5)))
    assert least.tolist() == pytest.approx([-8.0, 0.0])
    assert most.tolist() == pytest.approx([4.0, 12.0])


def test_who_never_quite_stops_has_no_end_of_its_acceleration():
    smooth = ZeroOrderHold(DiffKBM(load_vehicle("bicycle"), 0.05, SoftplusFloor()), 5)
    assert smooth.useful_acceleration(going(smooth, (0.2, 0.5))) is None


def test_what_a_model_says_of_itself_holds_for_its_hold():
    for name in MODELS:
        model = MODELS[name](0.05)
        held = ZeroOrderHold(model, 5)
        assert held.moves_with_pose == model.moves_with_pose
        assert held.keeps_top_speed == model.keeps_top_speed
    assert ZeroOrderHold(MODELS["kbm"](0.05), 5, speed_max_mps=1.0).keeps_top_speed


def test_the_hold_of_a_model_has_the_parameters_of_the_model_alone():
    model = MODELS["wheel_speed"](0.05)
    held = ZeroOrderHold(model, 5)
    assert list(held.state_dict()) == [f"model.{name}" for name in model.state_dict()]
    assert (model.dt_s, model.substeps) == (0.05, 1)


@pytest.mark.parametrize("name", ["kbm", "wheel_speed"])
def test_a_copy_of_a_hold_asks_its_own_model(name):
    held = ZeroOrderHold(MODELS[name](0.05), 5)
    again = copy.deepcopy(held).double()
    before = held.control_for(going(held, (2.0,)).float(), *torch.tensor([[0.5], [0.1]]))
    with torch.no_grad():
        for each in again.parameters():
            each.add_(0.5)
    wanted = torch.tensor([[0.5], [0.1]]).double()
    expected = again.model.lengthened(5).control_for(going(again, (2.0,)), *wanted)
    assert torch.equal(again.control_for(going(again, (2.0,)), *wanted), expected)
    assert not torch.allclose(before.double(), expected)


@pytest.mark.parametrize("name", ["gm3", "gm3_fine", "wheel_speed", "unicycle"])
def test_a_lengthened_model_takes_as_many_steps_at_once(name):
    model = MODELS[name](0.05).double()
    state, zero = going(model, (2.0, 3.0)), torch.zeros(2).double()
    control = model.control_for(state, zero + 0.5, zero + 0.1)
    expected = ZeroOrderHold(model, 5)(state, control)
    assert torch.allclose(model.lengthened(5)(state, control), expected, atol=1e-9)
