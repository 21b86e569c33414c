"""Physical parameters in training: their own rate, frozen or learned, and what reaches them."""

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3, DiffKBM, ExtendedUnicycle, SingleIntegrator
from diffstack_mmv.planning import PredictedGoal
from diffstack_mmv.prediction import Sizes, StandStill, Trajectron
from diffstack_mmv.stack import PhysicsLearning
from diffstack_mmv.vehicles import load_vehicle
from tests.stack.test_module import STEPS, batch_of, stack_of


def with_physics(physics):
    stack = stack_of(PredictedGoal(), StandStill(STEPS, 0.1))
    stack.physics = physics
    physics.freeze(stack.planner.dynamics)
    return stack


def test_learned_parameters_have_a_rate_of_their_own():
    stack = with_physics(PhysicsLearning(rate=0.1, learned=["wheelbase"]))
    groups = stack.configure_optimizers().param_groups
    assert [group["name"] for group in groups] == ["networks", "physics"]
    assert groups[1]["lr"] == pytest.approx(0.1 * groups[0]["lr"])
    assert groups[1]["params"] == [stack.planner.dynamics.wheelbase.offset]


def test_frozen_parameters_are_in_no_group_and_have_no_gradient():
    stack = with_physics(PhysicsLearning(learned=[]))
    assert len(stack.configure_optimizers().param_groups) == 1
    stack.planning_losses(batch_of(), stack(batch_of()))["control"].mean().backward()
    assert stack.planner.dynamics.wheelbase.offset.grad is None


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: PhysicsLearning(rate=0.0), "`physics.rate`"),
        (lambda: with_physics(PhysicsLearning(learned=["mass"])), "`physics.learned`"),
    ],
)
def test_a_rate_or_a_name_that_makes_no_sense_is_refused(make, told):
    with pytest.raises(ValueError, match=told):
        make()


@pytest.mark.parametrize("constant", ["drag", "length_scale"])
def test_what_the_vehicle_holds_constant_is_not_learned(constant):
    dynamics = DiffGM3(load_vehicle("bicycle"))
    PhysicsLearning(learned=["friction", "yaw_inertia"]).require_learnable(dynamics)
    told = f"`physics.learned` must be what the vehicle lets learn, but got {constant} of DiffGM3"
    with pytest.raises(ValueError, match=told):
        PhysicsLearning(learned=["friction", constant]).require_learnable(dynamics)


def test_a_training_that_could_not_move_what_it_is_to_learn_is_refused():
    stack = with_physics(PhysicsLearning(learned=["wheelbase"]))
    stack.planner.dynamics.requires_grad_(False)
    with pytest.raises(ValueError, match="`physics.learned` must be what the vehicle lets learn"):
        stack.configure_optimizers()


@pytest.mark.parametrize("loss", ["planning_ce", "planning_cost", "control"])
def test_losses_of_the_plan_reach_predictor_and_wheelbase(loss):
    torch.manual_seed(0)
    spec = load_vehicle("bicycle")
    predictor = Trajectron(
        DiffKBM(spec),
        ExtendedUnicycle(spec),
        SingleIntegrator(),
        horizon_steps=STEPS,
        components=3,
        neighbor_components=2,
        sizes=Sizes(8, 8, 8, 8, 0.0),
    )
    stack = stack_of(PredictedGoal(), predictor)
    for each in predictor.branches:  # away from zero, so that the prediction turns
        torch.nn.init.normal_(each.decoder.mean_head.weight, std=0.3)
    batch = batch_of()
    stack.planning_losses(batch, stack(batch))[loss].mean().backward()
    ego = predictor.branches[0].decoder
    for parameter in (ego.mean_head.weight, stack.planner.dynamics.wheelbase.offset):
        reached = parameter.grad is not None and bool(parameter.grad.abs().max() > 0)
        assert reached == (loss != "planning_ce" or parameter is ego.mean_head.weight)
