"""What every dynamics model must do with every vehicle, for all that `configs/` holds."""

from functools import cache

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from diffstack_mmv.dynamics import DynamicsModel, rollout
from diffstack_mmv.geometry import rotate
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import config_folder, vehicle_names

MODELS = sorted(path.stem for path in (config_folder() / "dynamics").glob("*.yaml"))
# every model with two layouts of wheels and every vehicle with each kind of model; other laws and
# steps of DiffGM3 with the other vehicles in the slow tests
BOTH_WAYS = {"unicycle", "kbm", "gm3"}, {"bicycle", "tricycle"}
PAIRS = [
    pytest.param(
        model,
        vehicle,
        marks=[] if model in BOTH_WAYS[0] or vehicle in BOTH_WAYS[1] else pytest.mark.slow,
    )
    for model in MODELS
    for vehicle in vehicle_names()
]
every_pair = pytest.mark.parametrize(("name", "vehicle"), PAIRS)


@cache
def build(name: str, vehicle: str) -> DynamicsModel:
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose(overrides=[f"+dynamics={name}", f"+vehicle={vehicle}", "+dt_s=0.1"])
    return instantiate(config.dynamics).double()


def motion(count=5, speed=3.0):
    torch.manual_seed(0)
    heading = torch.randn(count).double()
    forward = speed * (0.5 + torch.rand(count).double())
    return Motion(
        position=5 * torch.randn(count, 2).double(),
        heading=heading,
        velocity=torch.stack([forward, torch.zeros_like(forward)], -1),
        yaw_rate=0.2 * torch.randn(count).double(),
    )


def inputs(model, count=5):
    state = model.initial_state(motion(count))
    lower, upper = model.bounds
    share = 0.25 + 0.5 * torch.rand(count, model.control_dim).double()
    return state, lower + share * (upper - lower)


def angle_between(first, second):
    return torch.atan2((first - second).sin(), (first - second).cos()).abs()


@every_pair
def test_any_leading_dimensions_are_a_batch_of_single_steps(name, vehicle):
    model = build(name, vehicle)
    state, control = inputs(model, 6)
    together = model(state, control)
    alone = torch.stack([model(x, u) for x, u in zip(state, control, strict=True)])
    shaped = model(state.reshape(2, 3, -1), control.reshape(2, 3, -1))
    assert torch.allclose(together, alone, atol=1e-10)
    assert torch.allclose(together, shaped.reshape(6, -1), atol=1e-10)


@every_pair
def test_gradients_are_exact_in_state_control_and_parameters(name, vehicle):
    model = build(name, vehicle)
    state, control = (part.detach().requires_grad_() for part in inputs(model, 2))
    learned = [p for p in model.parameters() if p.requires_grad]

    def step(state, control, *parameters):
        return model(state, control)

    torch.autograd.gradcheck(
        step, (state, control, *learned), eps=1e-7, rtol=1e-3, atol=1e-3, fast_mode=True
    )


@every_pair
def test_moving_the_world_moves_the_path(name, vehicle):
    model = build(name, vehicle)
    start = motion()
    turn, shift = torch.tensor(0.7).double(), torch.tensor([3.0, -2.0]).double()
    moved = start._replace(
        position=rotate(start.position, turn) + shift, heading=start.heading + turn
    )
    control = inputs(model)[1]
    # commands in directions of the world turn with it
    turned = rotate(control, turn) if "velocity_x" in model.Control._fields else control
    here = model.motion(model(model.initial_state(start), control), control)
    there = model.motion(model(model.initial_state(moved), turned), turned)
    assert torch.allclose(there.position, rotate(here.position, turn) + shift, atol=1e-9)
    assert angle_between(there.heading, here.heading + turn).max() < 1e-9
    assert torch.allclose(there.velocity, here.velocity, atol=1e-9)


@every_pair
def test_mirrored_turn_mirrors_the_path(name, vehicle):
    model = build(name, vehicle)
    start = motion()._replace(heading=torch.zeros(5).double())
    flip = torch.tensor([1.0, -1.0]).double()
    mirrored = start._replace(
        position=start.position * flip, velocity=start.velocity * flip, yaw_rate=-start.yaw_rate
    )
    acceleration, curvature = torch.full((5,), 0.3).double(), torch.full((5,), 0.1).double()
    paths = []
    for begin, sign in ((start, 1), (mirrored, -1)):
        state = model.initial_state(begin)
        control = model.control_for(state, acceleration, sign * curvature)
        paths.append(model.motion(model(state, control), control))
    assert torch.allclose(paths[1].position, paths[0].position * flip, atol=1e-9)
    assert torch.allclose(paths[1].yaw_rate, -paths[0].yaw_rate, atol=1e-9)


@every_pair
def test_rest_and_saturation_give_finite_values_and_gradients(name, vehicle):
    model = build(name, vehicle)
    lower, upper = model.bounds
    rest = motion(1, 0.0)._replace(yaw_rate=torch.zeros(1).double())
    states = torch.cat([model.initial_state(rest), model.initial_state(motion(1, 10.0))])
    for control in (torch.zeros_like(lower), 3 * lower, 3 * upper):
        state = states.detach().requires_grad_()
        held = control.double().clone().requires_grad_()
        end = rollout(model, state, held.expand(2, 10, -1))
        gradients = torch.autograd.grad(end.sum(), (state, held))
        assert all(bool(torch.isfinite(value).all()) for value in (end, *gradients))


@every_pair
def test_initial_state_gives_back_pose_and_speed(name, vehicle):
    model = build(name, vehicle)
    start = motion()
    state, control = model.initial_state(start), inputs(model)[1]
    back = model.motion(state, control)
    assert torch.allclose(back.position, start.position)
    assert torch.allclose(back.heading, start.heading)
    assert torch.allclose(back.velocity[..., 0], start.velocity[..., 0])


@every_pair
def test_tracked_point_moves_along_its_course(name, vehicle):
    model = build(name, vehicle)
    course = motion()
    back = model.motion(model.state_on_course(course), inputs(model)[1])
    slip = torch.atan2(back.velocity[..., 1], back.velocity[..., 0])
    assert angle_between(back.heading + slip, course.heading).max() < 1e-9
    assert torch.allclose(back.velocity.norm(dim=-1), course.velocity[..., 0], atol=1e-9)


@every_pair
def test_control_for_a_curve_stays_within_the_bounds(name, vehicle):
    model = build(name, vehicle)
    state = model.initial_state(motion())
    for acceleration, curvature in ((0.0, 0.0), (50.0, 9.0), (-50.0, -9.0)):
        one = torch.ones(5).double()
        control = model.control_for(state, acceleration * one, curvature * one)
        assert torch.equal(control, model.within_bounds(control))


@every_pair
def test_a_curve_that_is_held_has_its_sign_and_is_no_sharper(name, vehicle):
    model = build(name, vehicle)
    state = model.initial_state(motion())
    for acceleration, curvature in ((0.0, 0.0), (3.0, 0.5), (-50.0, -9.0)):
        one = torch.ones(5).double()
        asked = curvature * one
        held = model.curvature_within_grip(state, acceleration * one, asked)
        assert (held * asked >= 0).all()
        assert (held.abs() <= asked.abs()).all()


@every_pair
def test_parameters_survive_saving(name, vehicle):
    model = build(name, vehicle)
    assert all(bool(torch.isfinite(value).all()) for value in model.physical_parameters().values())
    assert set(model.state_dict()) == {key for key, _ in model.named_parameters()}
