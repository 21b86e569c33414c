"""A controller with several models of its vehicle drives by the one that explains the motion."""

import numpy as np
import pytest
import torch
from hydra.utils import instantiate

from diffstack_mmv.simulation import AdaptiveController, DiscFootprint, vehicle_robot
from diffstack_mmv.types import map_tensors
from tests.simulation.conftest import composed_navigate


@pytest.fixture
def seen(world_with, driven, scene_with):
    """A bicycle at 2 m/s among people who are far away."""
    world = world_with(vehicle_robot(driven(), footprint=DiscFootprint()), exact=True, limit_s=10.0)
    scene = map_tensors(lambda field: field.unsqueeze(0), scene_with((9.0, 0.0), (9.0, 1.0)))
    seen = world.observe(world.start(scene))
    velocity = torch.tensor([[2.0, 0.0]]).to(seen.motion.velocity)
    return seen._replace(motion=seen.motion._replace(velocity=velocity))


@pytest.mark.parametrize("true", [0, 1])
def test_the_model_that_explains_the_turn_is_driven_by(true, seen, controller_for):
    other = controller_for("motorcycle", starts=0).planner.dynamics
    controller = AdaptiveController(controller_for(starts=0), [other])
    with torch.no_grad():
        _, state = controller.act(controller.init(seen), seen)
        assert state.chosen.tolist() == [0]
        command = torch.tensor([[0.0, 0.5]])
        state.inner.plan[:, 0] = command
        model = controller.models[true]
        before = map_tensors(lambda field: field.to(command), seen.motion)
        turned = model.motion(model(model.initial_state(before), command), command)
        _, state = controller.act(state, seen._replace(motion=turned))
    assert state.chosen.tolist() == [true]


def test_thoughts_are_one_per_decision_whatever_model_took_it(seen, controller_for):
    other = controller_for("motorcycle", starts=0).planner.dynamics
    controller = AdaptiveController(controller_for(starts=0), [other])
    two = map_tensors(lambda entry: torch.cat([entry, entry]), seen)
    with torch.no_grad():
        state = controller.init(two)
        state = state._replace(error=torch.tensor([[0.0, 1.0], [1.0, 0.0]]).to(state.error))
        _, state = controller.act(state, two)
    assert state.chosen.tolist() == [0, 1]
    thoughts = controller.thoughts(state)
    assert thoughts["plan"].shape[:2] == (2, 1)
    assert np.isfinite(thoughts["plan"]).all()
    assert controller.diagnosis(state)["candidate_share"].shape == (2,)


def test_all_models_are_planned_with_in_the_same_way():
    """Limits of the optimiser and the delay hold whatever the friction."""
    limits = "constraints=hard", "cost=unlimited", "dynamics=gm3"
    controller = instantiate(composed_navigate("controller=diffmpc_adaptive", *limits).controller)
    first, *others = controller.controllers
    delayed = instantiate(composed_navigate("controller=diffmpc_delay").controller)
    first.delay = delayed.delay
    again = AdaptiveController(first, [each.planner.dynamics for each in others])
    assert first.planner.constraints is not None
    assert len(again.controllers) == 3
    assert first.delay is not None
    for each in again.controllers:
        assert each.planner.constraints is first.planner.constraints
        assert each.planner.coordinates is first.planner.coordinates
        assert each.delay is first.delay


@pytest.mark.parametrize(("dynamics", "models"), [("kbm", 1), ("gm3", 3)])
def test_models_that_foretell_the_same_are_one(dynamics, models, caplog):
    """A kinematic bicycle has no friction to adapt to."""
    overrides = "controller=diffmpc_adaptive", f"dynamics={dynamics}"
    controller = instantiate(composed_navigate(*overrides).controller)
    assert len(controller.models) == len(controller.controllers) == models
    assert ("Friction is felt by tyres alone" in caplog.text) is (models == 1)


@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_other_frictions_are_those_of_the_vehicle_that_is_believed_in(factor) -> None:
    overrides = "controller=diffmpc_adaptive", "dynamics=gm3", f"believed.mass_factor={factor}"
    first, *others = instantiate(composed_navigate(*overrides).controller).models
    mass = 1 / first.model.chassis.inverse_mass[..., 0]
    assert len(others) == 2
    for each in others:
        torch.testing.assert_close(1 / each.model.chassis.inverse_mass[..., 0], mass)


@pytest.mark.parametrize(("name", "models"), [("kbm", 1), ("gm3", 3)])
def test_other_frictions_are_of_the_dynamics_that_are_believed_in(name, models) -> None:
    overrides = "controller=diffmpc_adaptive", "dynamics=gm3", f"believed.dynamics={name}"
    assert len(instantiate(composed_navigate(*overrides).controller).models) == models


def test_models_that_foretell_another_time_than_a_decision_are_refused():
    """Who decides every 0.1 s cannot judge what a model foretells for 0.25 s."""
    with pytest.raises(ValueError, match=r"`models` must have the step of a decision, 0.1 s"):
        AdaptiveController(controller_deciding_every(0.1), [])


def controller_deciding_every(dt_s):
    return instantiate(composed_navigate(f"dt_s={dt_s}", "limit_s=10").controller)
