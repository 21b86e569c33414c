"""Cost weights tuned by what driving with them comes to."""

import math

import pytest
import torch

from diffstack_mmv.control import ILQR
from diffstack_mmv.costs import ControlEffort, RunningGoal, WeightedCost
from diffstack_mmv.planning import TakeOptimum
from diffstack_mmv.simulation import BlindDriver, DiscFootprint, vehicle_robot
from diffstack_mmv.simulation.tuning import DrivingLoss, GradientTuner, OptunaTuner, Round, best


@pytest.fixture
def cost():
    terms = {"position": RunningGoal(), "effort": ControlEffort()}
    return WeightedCost(terms, {"position": 1.0, "effort": 1.0})


@pytest.fixture
def circle(world_with, driven, scenario_of):
    world = world_with(vehicle_robot(driven(), footprint=DiscFootprint()), exact=True, limit_s=10.0)
    return world, scenario_of("circle").cases("train", range(3))


def wanted(cost):
    """Smallest where positions weigh e times as much as effort."""
    return lambda: (cost.log_weight[0] - cost.log_weight[1] - 1.0).square()


def test_the_gradient_leads_to_the_weights_wanted(cost):
    rounds = list(GradientTuner(rounds=60)(cost, wanted(cost)))
    chosen = best(rounds)
    assert len(rounds) == 60
    assert chosen.weights["position"] / chosen.weights["effort"] == pytest.approx(2.718, rel=0.05)
    assert rounds[0].weights == pytest.approx({"position": 1.0, "effort": 1.0})


def test_a_round_without_a_finite_gradient_keeps_the_weights(cost, caplog):
    rounds = list(GradientTuner(rounds=2)(cost, lambda: cost.log_weight.sum() * torch.nan))
    assert rounds[0].weights == rounds[1].weights
    assert "not finite" in caplog.text


def apart(rounds):
    """By how much the logarithms of both weights differ in each round."""
    both = [(each.weights["position"], each.weights["effort"]) for each in rounds]
    return [math.log(position / effort) for position, effort in both]


def test_the_steps_of_the_gradient_fall_to_zero_over_the_rounds(cost):
    tuner = GradientTuner(rounds=4, learning_rate=0.2)
    found = apart(tuner(cost, lambda: 5 * (cost.log_weight[0] - cost.log_weight[1])))
    assert found == pytest.approx([0.0, -0.4, -0.7, -0.9], abs=1e-5)


def test_one_round_with_a_steep_loss_does_not_decide_the_next(cost):
    slopes = iter([1e6, -2.0, -2.0])
    tuner = GradientTuner(rounds=3)
    found = apart(tuner(cost, lambda: next(slopes) * (cost.log_weight[0] - cost.log_weight[1])))
    assert found[1] < found[2] < found[0]


def test_optuna_searches_within_its_factor(cost):
    pytest.importorskip("optuna", reason="needs the extra `tune`")
    beyond = OptunaTuner(rounds=12, factor=2.0)(cost, lambda: -cost.log_weight[0])
    tried = [float(cost.log_weight[0].detach().exp()) for _ in beyond]
    assert tried[0] == 1.0
    assert 1.5 < max(tried) <= 2.0
    assert 0.5 <= min(tried) < 1.0


@pytest.mark.parametrize("tuner", [GradientTuner(rounds=1), OptunaTuner(rounds=1)], ids=repr)
def test_one_round_tells_the_loss_of_the_weights_given(cost, tuner):
    if isinstance(tuner, OptunaTuner):
        pytest.importorskip("optuna", reason="needs the extra `tune`")
    [only] = tuner(cost, wanted(cost))
    assert only.loss == 1.0
    assert only.weights == pytest.approx({"position": 1.0, "effort": 1.0})


def test_optuna_begins_with_the_weights_given(cost):
    pytest.importorskip("optuna", reason="needs the extra `tune`")
    rounds = list(OptunaTuner(rounds=12)(cost, wanted(cost)))
    assert rounds[0].weights == pytest.approx({"position": 1.0, "effort": 1.0})
    assert best(rounds).loss < rounds[0].loss


class Standing:
    """A driver that stays where it is."""

    def init(self, observation):
        return

    def act(self, state, observation):
        return torch.zeros(len(observation.time), 2), None


@pytest.mark.parametrize(("way_m", "second"), [(9.5, 0.95), (0.5, 0.5)], ids=["far", "near"])
def test_who_stands_pays_for_the_time_also_half_a_metre_short_of_the_goal(circle, way_m, second):
    world, scene = circle
    gap = scene.robot_goal - scene.robot_position
    goal = scene.robot_position + way_m * gap / gap.norm(dim=-1, keepdim=True)
    loss = DrivingLoss(clearance_weight=0.0, steps=8)
    paid = loss(world, scene._replace(robot_goal=goal), Standing())
    assert paid.tolist() == pytest.approx([2 * second] * 3)


def test_contact_costs_and_arrival_ends_the_count(circle, driven):
    driver = BlindDriver(driven().model(0.05), 3.0)
    free = DrivingLoss(clearance_weight=0.0, steps=40)(*circle, driver)
    longer = DrivingLoss(clearance_weight=0.0, steps=60)(*circle, driver)
    paid = DrivingLoss(clearance_weight=40.0, steps=40)(*circle, driver)
    assert torch.equal(free, longer)
    assert bool((paid >= free).all())


def test_the_loss_has_a_gradient_in_the_weights(circle, controller_for):
    controller = controller_for()
    controller.planner.solver = ILQR(max_iterations=60, tolerance=1e-5)
    controller.planner.choice = TakeOptimum()
    loss = DrivingLoss(steps=2)(*circle, controller).mean()
    (gradient,) = torch.autograd.grad(loss, controller.planner.cost.log_weight)
    assert bool(gradient.isfinite().all())
    assert float(gradient.abs().max()) > 0


@pytest.mark.parametrize(
    ("build", "name"),
    [
        (lambda: GradientTuner(rounds=0), "rounds"),
        (lambda: OptunaTuner(factor=0.5), "`factor` must be finite and above 1, but got 0.5"),
        *((lambda f=f: OptunaTuner(factor=f), "`factor`") for f in (1.0, math.inf, math.nan)),
        (lambda: DrivingLoss(steps=0), "steps"),
        (lambda: DrivingLoss(clearance_m=0.0), "clearance_m"),
        (lambda: DrivingLoss(near_m=0.0), "near_m"),
    ],
)
def test_numbers_out_of_range_are_refused(build, name):
    with pytest.raises(ValueError, match=name):
        build()


def test_a_cost_without_a_weight_to_tune_is_refused(refusal, tmp_path):
    frozen = "cost.frozen=[position,heading,speed,barrier,yaw_rate,effort]"
    told = refusal("tune", "cases=1", frozen, f"out={tmp_path}")
    assert "`cost.frozen` must leave a weight to tune, but got ['position', " in told


@pytest.mark.slow
def test_an_interrupted_tuning_leaves_the_best_weights_which_no_other_one_replaces(
    refusal, monkeypatch, tmp_path
):
    def rounds(self, cost, loss):
        yield Round({"position": 2.0}, 1.0, 0.0)
        yield Round({"position": 3.0}, 4.0, 0.0)
        raise ValueError("interrupted")

    monkeypatch.setattr(GradientTuner, "__call__", rounds)
    assert "interrupted" in refusal("tune", "cases=1", f"out={tmp_path}")
    found = (tmp_path / "settings.txt").read_text().splitlines()
    assert found == [
        "cost.weights.position=2",
        "controller.planner.solver.max_iterations=60",
        "controller.planner.coordinates._target_=diffstack_mmv.planning.above_rest",
    ]
    told = refusal("tune", "cases=2", f"out={tmp_path}")
    assert "`out` must hold no result of tune with another cases than 2, but got 1" in told
