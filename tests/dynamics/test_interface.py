"""What a model says of itself: driver input, reference point, wheels, derived quantities."""

import copy
import pickle
from dataclasses import replace
from typing import NamedTuple

import pytest
import torch
import yaml
from torch import Tensor

from diffstack_mmv.control import Selectable
from diffstack_mmv.dynamics import (
    DiffGM3,
    DiffKBM,
    DriverInput,
    DynamicsModel,
    ExtendedUnicycle,
    Holonomic,
    SingleIntegrator,
    rollout,
)
from diffstack_mmv.dynamics.catalogue import dynamics_names, load_dynamics, model_of
from diffstack_mmv.dynamics.gm3 import DiffGM3WheelSpeed
from diffstack_mmv.dynamics.manoeuvres import Slalom
from diffstack_mmv.dynamics.open_loop import drive, wheel_history
from diffstack_mmv.simulation import (
    CircleCrossing,
    SimulatedVehicle,
    VehicleRobot,
    ZeroOrderHold,
    controller_model,
)
from diffstack_mmv.types import Bounds, Motion
from diffstack_mmv.vehicles import config_folder, load_vehicle, vehicle_names

LIMITS = {"speed_max_mps": 3.0, "acceleration_min_mps2": -3.0, "acceleration_max_mps2": 2.0}


class Tricycle(DynamicsModel):
    """A toy: heading turns with the angle of the front wheel, whatever the speed."""

    class State(NamedTuple):
        """Position, heading, speed."""

        position_x: Tensor
        position_y: Tensor
        heading: Tensor
        speed: Tensor

    class Control(NamedTuple):
        """Half the acceleration, twice the angle."""

        half_acceleration: Tensor
        double_steer: Tensor

    def __init__(self, spec=None, dt_s=0.1):
        super().__init__(dt_s, (-2.0, -1.0), (2.0, 1.0))

    def step(self, state, control):
        x, y, heading, speed = state.unbind(-1)
        after = [
            x + self.dt_s * speed * heading.cos(),
            y + self.dt_s * speed * heading.sin(),
            heading + self.dt_s * control[..., 1] / 2,
            speed + self.dt_s * 2 * control[..., 0],
        ]
        return torch.stack(after, -1)

    def motion(self, states, controls):
        velocity = torch.stack([states[..., 3], torch.zeros_like(states[..., 3])], -1)
        return Motion(states[..., :2], states[..., 2], velocity, controls[..., 1] / 2)

    def initial_state(self, motion):
        parts = [motion.position, motion.heading.unsqueeze(-1), motion.velocity[..., :1]]
        return torch.cat(parts, -1)

    def control_for(self, state, acceleration, curvature):
        return torch.stack([acceleration / 2, 2 * curvature * state[..., 3]], -1)

    def control_for_driver(self, state, driver):
        return torch.stack([driver.acceleration / 2, 2 * driver.steer], -1)


@pytest.fixture
def simulated():
    """A bicycle of the benchmark in the eyes of some dynamics."""
    mapping = yaml.safe_load((config_folder() / "vehicle" / "bicycle.yaml").read_text())
    return lambda dynamics: SimulatedVehicle(mapping, dynamics, LIMITS)


@pytest.mark.parametrize(
    ("lower", "told"),
    [((-2.0,), "`control_lower` must hold a number for each of half_acceleration, double_steer")],
)
def test_a_model_without_a_bound_for_each_control_is_refused(lower, told):
    with pytest.raises(ValueError, match="must hold") as raised:
        DynamicsModel.__init__(Tricycle.__new__(Tricycle), 0.1, lower, (2.0, 1.0))
    assert told in str(raised.value)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_bounds_given_as_whole_numbers_are_real_ones(dtype):
    model = SingleIntegrator(0.1, 4).to(dtype)
    wanted = torch.full((2,), 4.0, dtype=dtype)
    torch.testing.assert_close(model.bounds, Bounds(-wanted, wanted))
    assert model(torch.zeros(4, dtype=dtype), wanted).dtype == dtype


@pytest.mark.parametrize("dynamics", dynamics_names())
@pytest.mark.parametrize("held", [False, True])
def test_bounds_are_those_that_were_given_in_every_precision(dynamics, held):
    model = model_of("scooter", dynamics, 0.05)
    model = ZeroOrderHold(model, 2) if held else model
    given = [list(model.control_lower), list(model.control_upper)]
    for precise in (copy.deepcopy(model).double(), copy.deepcopy(model).double().float().double()):
        assert [bound.tolist() for bound in precise.bounds] == given
    for bound, numbers in zip(model.bounds, given, strict=True):
        assert torch.equal(bound, torch.tensor(numbers))
    assert not {name for name in model.state_dict() if name.endswith(("_lower", "_upper"))}


@pytest.mark.parametrize("vehicle", vehicle_names())
def test_bounds_in_double_precision_are_the_numbers_of_the_file(vehicle):
    limits = yaml.safe_load((config_folder() / "vehicle" / f"{vehicle}.yaml").read_text())["limits"]
    lower, upper = DiffKBM(load_vehicle(vehicle)).double().bounds
    assert lower.tolist() == [limits["acceleration_min_mps2"], -limits["steer_max_rad"]]
    assert upper.tolist() == [limits["acceleration_max_mps2"], limits["steer_max_rad"]]


@pytest.mark.parametrize("model", [SingleIntegrator(), Holonomic(load_vehicle("bicycle"))])
def test_a_course_has_no_slope_at_rest(model):
    velocity = torch.zeros(3, 2, requires_grad=True)
    still = Motion(torch.ones(3, 2), torch.zeros(3), velocity, torch.zeros(3))
    state = model.initial_state(still)
    heading = model.motion(state, torch.zeros(3, 2)).heading
    slope = torch.autograd.grad(heading.sum(), velocity)[0]
    assert torch.equal(heading, torch.zeros(3))
    assert torch.equal(slope, torch.zeros(3, 2))


@pytest.mark.parametrize("dynamics", dynamics_names())
def test_states_and_controls_of_different_batches_are_broadcast(dynamics):
    model = model_of(load_vehicle("bicycle"), load_dynamics(dynamics), 0.05)
    n, m = model.state_dim, model.control_dim
    state, control = 0.5 + torch.rand(5, 1, n), 0.1 * torch.rand(3, m)
    after = model(state, control)
    assert after.shape == (5, 3, n)
    torch.testing.assert_close(after[2, 1], model(state[2, 0], control[1]))
    assert model(state[0, 0], control).shape == (3, n)
    assert model(state[:, 0], control[0]).shape == (5, n)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("dynamics", dynamics_names())
def test_states_and_controls_of_batches_that_do_not_fit_are_told_by_shape(dynamics):
    model = model_of(load_vehicle("bicycle"), load_dynamics(dynamics), 0.05)
    state, control = torch.zeros(2, 4, model.state_dim), torch.zeros(3, model.control_dim)
    needs = r"`control` must have leading dimensions that fit those of the state, \(2, 4\), but got"
    with pytest.raises(ValueError, match=rf"{needs} shape \(3, {model.control_dim}\)"):
        model(state, control)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("dynamics", dynamics_names())
def test_the_motion_of_states_of_another_model_is_refused(dynamics):
    model = model_of(load_vehicle("bicycle"), load_dynamics(dynamics), 0.05)
    wide = torch.zeros(2, model.state_dim + 4)
    with pytest.raises(ValueError, match=f"`states` must have {model.state_dim} columns"):
        model.motion(wide, torch.zeros(2, model.control_dim))


@pytest.mark.usefixtures("unchecked")
def test_the_right_hand_side_of_gm3_refuses_columns_that_it_would_not_read():
    model = DiffGM3(load_vehicle("bicycle"))
    with pytest.raises(ValueError, match=r"`control` must have 2 columns \(acceleration, steer\)"):
        model.derivative(torch.zeros(2, 8), torch.zeros(2, 3))


@pytest.mark.parametrize("dynamics", dynamics_names())
def test_a_model_survives_pickling(dynamics):
    model = model_of(load_vehicle("bicycle"), load_dynamics(dynamics), 0.05)
    again = pickle.loads(pickle.dumps(model))
    assert again.Control._fields == copy.deepcopy(model).Control._fields == model.Control._fields
    state = 0.5 + torch.rand(2, model.state_dim)
    control = 0.1 * torch.rand(2, model.control_dim)
    assert torch.equal(again(state, control), model(state, control))


def test_a_toy_model_works_everywhere_without_registration():
    spec, toy = load_vehicle("bicycle"), Tricycle().double()
    run = drive(toy, Slalom(3.0, 0.05, 4.0)(1.05, 0.1), 3.0)
    assert run.states.shape == (41, 4)
    assert torch.equal(rollout(toy, run.states[0], run.controls), run.states)
    assert wheel_history(toy, run) is None
    robot = VehicleRobot(model_of(spec, Tricycle, 0.01))
    scene = CircleCrossing().case("test", 0)
    travel = robot.step(robot.start(scene), torch.tensor([1.0, 0.0]).double(), 0.25)
    assert robot.motion(travel.state).velocity[0] == pytest.approx(0.5)


def test_a_toy_model_is_what_a_controller_believes(simulated):
    believed, actual = simulated(Tricycle), simulated("gm3")
    model = controller_model(believed, actual)
    assert isinstance(model.model, Tricycle)
    assert (model.dt_s, model.repeats, model.ahead_m) == (0.25, 1, 0.0)


def states_of(model):
    speed = torch.tensor([1.0, 3.0, 6.0]).double()
    velocity = torch.stack([speed, torch.zeros_like(speed)], -1)
    zero = torch.zeros_like(speed)
    return model.initial_state(Motion(torch.zeros(3, 2).double(), zero, velocity, 0.1 * speed))


KINDS = [DiffGM3, DiffGM3WheelSpeed, DiffKBM, ExtendedUnicycle]


@pytest.mark.parametrize("vehicle", vehicle_names())
@pytest.mark.parametrize("kind", KINDS)
def test_a_control_means_the_input_it_was_made_for(kind, vehicle):
    model = kind(load_vehicle(vehicle)).double()
    state = states_of(model)
    steer = torch.tensor([0.1, -0.2, 0.05]).double()
    wanted = DriverInput(torch.tensor([0.5, -1.0, 0.0]).double(), steer)
    found = model.driver_input(state, model.control_for_driver(state, wanted))
    assert torch.allclose(found.acceleration, wanted.acceleration, atol=1e-9)
    assert torch.allclose(found.steer, wanted.steer, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_model_says_whether_its_control_means_the_same_at_every_speed(kind) -> None:
    model = kind(load_vehicle("bicycle")).double()
    found = model.driver_input(states_of(model), (model.bounds.upper / 4).expand(3, -1))
    same = all(bool((part == part[0]).all()) for part in found)
    assert same is not model.driver_input_needs_state


def test_a_unicycle_at_rest_goes_straight():
    model = ExtendedUnicycle(load_vehicle("bicycle"))
    found = model.driver_input(torch.zeros(4), torch.tensor([0.5, 0.0]))
    assert found.steer == 0


@pytest.mark.parametrize("method", ["driver_input", "control_for_driver"])
def test_a_model_that_is_not_steered_by_an_angle_refuses_a_driver(method):
    model = SingleIntegrator()
    given = torch.zeros(2) if method == "driver_input" else DriverInput(*torch.zeros(2))
    with pytest.raises(ValueError, match=r"`dynamics` must be steered by an angle, but got Single"):
        getattr(model, method)(torch.zeros(4), given)


@pytest.mark.parametrize(
    ("name", "axle_m"), [("bicycle", -0.45), ("skateboard", 0.0), ("wheelchair", -0.15)]
)
def test_the_reference_point_is_the_centre_of_gravity_or_the_axle_that_does_not_steer(name, axle_m):
    spec = load_vehicle(name)
    assert DiffGM3(spec).reference_ahead_m == 0
    assert DiffKBM(spec).reference_ahead_m == pytest.approx(axle_m)
    assert ExtendedUnicycle(spec).reference_ahead_m == pytest.approx(axle_m)


def test_only_an_explicit_scheme_bounds_its_step_and_acts_a_step_late():
    spec = load_vehicle("bicycle")
    assert DiffKBM(spec).longest_step_s == 0.05
    assert DiffGM3(spec).longest_step_s == float("inf")
    assert DiffKBM(spec).acts_a_step_late
    assert not DiffGM3(spec).acts_a_step_late


@pytest.mark.parametrize(
    ("name", "count"), [("bicycle", 4), ("wheelchair", 1), ("hoverboard", 1), ("tricycle", 4)]
)
def test_axle_quantities_exist_where_both_axles_are_tyred(name, count):
    assert len(DiffGM3(load_vehicle(name)).derived_quantities()) == count


def test_axle_quantities_are_not_told_of_wheels_on_three_axles():
    """The formulas of two axles would tell another sign of understeer than the vehicle has."""
    spec = load_vehicle("tricycle")
    front, left, right = spec.wheels
    staggered = replace(spec, wheels=(front, left, replace(right, x_m=right.x_m + 0.2)))
    assert list(DiffGM3(staggered).derived_quantities()) == ["steer_per_curvature_at_5_mps"]


@pytest.mark.parametrize("name", dynamics_names())
def test_a_model_tells_what_it_is(name):
    model = model_of("bicycle", name, 0.05)
    told = model.description()
    assert (told["class"], told["step_s"]) == (type(model).__name__, 0.05)
    assert (told["tyre_law"] is None) == (not isinstance(model, DiffGM3))


def test_variants_tell_what_sets_them_apart():
    told = {name: model_of("bicycle", name, 0.1).description() for name in dynamics_names()}
    assert told["gm3_paper"]["tyre_law"] == "PaperBrush(steepness=100.0, epsilon=1e-08)"
    assert told["gm3_fine"]["substeps"] == 4
    assert told["kbm_smooth"]["speed_floor"] == "SoftplusFloor(width_mps=0.05)"
    assert len({str(each) for each in told.values()}) == len(told)


def test_a_model_serves_any_part_of_a_batch():
    model = DiffKBM(load_vehicle("bicycle"))
    held = ZeroOrderHold(model, 3)
    assert isinstance(model, Selectable)
    assert model.select(torch.tensor([1])) is model
    assert held.select(torch.tensor([1])) is held


@pytest.mark.parametrize("dynamics", dynamics_names())
def test_one_arc_serves_a_batch_of_states_and_one_state_a_batch_of_arcs(dynamics):
    model = model_of(load_vehicle("bicycle"), load_dynamics(dynamics), 0.05)
    states, one = 0.5 + torch.rand(3, model.state_dim), torch.tensor(0.1)
    found = model.control_for(states, one, one)
    assert found.shape == (3, model.control_dim)
    torch.testing.assert_close(found[1], model.control_for(states[1], one, one))
    arcs = torch.linspace(-0.1, 0.1, 3)
    assert model.control_for(states[0], one, arcs).shape == (3, model.control_dim)


def test_a_unicycle_tells_the_yaw_rate_that_it_turns_at():
    model = ExtendedUnicycle(load_vehicle("bicycle"))
    state, control = torch.tensor([0.0, 0.0, 0.0, 3.0]), torch.tensor([10.0, 0.0])
    turned = model(state, control)[2] / model.dt_s
    assert float(model.motion(state, control).yaw_rate) == pytest.approx(float(turned))


@pytest.mark.parametrize("curvature", [-0.4, 0.4])
@pytest.mark.parametrize(("model", "share"), [(DiffKBM, 1.0), (ExtendedUnicycle, 0.5)])
def test_the_control_for_a_curvature_turns_by_it_along_the_way(model, share, curvature, double):
    """The way of a step goes with the speed at its end, or in its middle."""
    made = model(load_vehicle("bicycle"), dt_s=0.25)
    speed, acceleration = 1.5, torch.tensor([1.2])
    state = torch.tensor([[0.0, 0.0, 0.3, speed]])
    control = made.control_for(state, acceleration, torch.tensor([curvature]))
    way = 0.25 * (speed + share * 0.25 * 1.2)
    turned = made(state, control)[0, 2].item() - 0.3
    assert turned == pytest.approx(curvature * way, rel=1e-6)
