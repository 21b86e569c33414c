"""What training logs beside its losses."""

import types

import pytest
import torch

from diffstack_mmv.callbacks import FiniteGradients, GradientNorms, LearnedParameters, Throughput
from diffstack_mmv.costs import ControlEffort, FinalGoal, WeightedCost
from diffstack_mmv.dynamics import DiffGM3, DiffKBM
from diffstack_mmv.vehicles import load_vehicle

# stand-ins for the trainer and the module of Lightning
pytestmark = pytest.mark.usefixtures("unchecked")


class Stack(torch.nn.Module):
    """The parts that monitors look at, and a log to read back."""

    def __init__(self, dynamics):
        super().__init__()
        self.predictor = torch.nn.Linear(2, 1)
        terms = {"goal": FinalGoal(), "effort": ControlEffort()}
        cost = WeightedCost(terms, {"goal": 1.0, "effort": 0.1})
        self.planner = types.SimpleNamespace(cost=cost, dynamics=dynamics)
        self.logged = {}

    def log(self, name, value):
        self.logged[name] = float(value)

    def log_dict(self, values):
        for name, value in values.items():
            self.log(name, value)


@pytest.fixture
def stack():
    return Stack(DiffKBM(load_vehicle("bicycle")))


def test_parameters_are_logged_in_physical_units(stack):
    LearnedParameters().on_train_epoch_end(None, stack)
    assert stack.logged["physical/wheelbase"] == pytest.approx(1.05)
    assert {"cost_weight/goal", "cost_weight/effort"} <= set(stack.logged)


def test_a_parameter_per_wheel_gets_one_entry_per_wheel():
    stack = Stack(DiffGM3(load_vehicle("bicycle")))
    LearnedParameters().on_train_epoch_end(None, stack)
    assert stack.logged["physical/friction/0"] == pytest.approx(0.8)
    assert stack.logged["physical/friction/1"] == pytest.approx(0.8)


def test_gradient_norms_are_told_apart_by_part(stack):
    stack.predictor(torch.tensor([[3.0, 4.0]])).sum().backward()
    GradientNorms().on_before_optimizer_step(None, stack, None)
    # the gradient is (3, 4) of the weight and 1 of the bias; cost and dynamics got none
    assert stack.logged == {"gradient/predictor": pytest.approx(26**0.5)}


def test_throughput_counts_waiting_for_data(stack, monkeypatch):
    clock = iter([0.0, 1.0, 4.0])
    monkeypatch.setattr("time.perf_counter", lambda: next(clock))
    monitor, batch = Throughput(), types.SimpleNamespace(goal=torch.zeros(8, 2))
    monitor.on_train_epoch_start(None, stack)
    monitor.on_train_batch_start(None, stack, batch, 0)
    monitor.on_train_batch_end(None, stack, None, batch, 0)
    assert stack.logged == {"throughput/samples_per_s": 2.0, "throughput/waiting_share": 0.25}


@pytest.mark.parametrize("kind", ["SGD", "AdamW"])
def test_a_gradient_that_is_not_finite_changes_nothing(kind):
    torch.manual_seed(0)
    layer, watch = torch.nn.Linear(3, 2), FiniteGradients()
    optimizer = getattr(torch.optim, kind)(layer.parameters(), lr=0.1, weight_decay=0.1)
    for scale in (1.0, float("nan"), float("inf"), 1.0):
        before = [p.detach().clone() for p in layer.parameters()]
        optimizer.zero_grad()
        (scale * layer(torch.ones(1, 3))[0, 0]).backward()
        watch.on_before_optimizer_step(None, layer, optimizer)
        optimizer.step()
        unchanged = all(torch.equal(a, b) for a, b in zip(before, layer.parameters(), strict=True))
        assert unchanged == (scale != 1.0)


@pytest.mark.parametrize("bad", [0, 1, 2])
def test_an_epoch_tells_its_steps_left_out_and_stops_if_there_are_many(stack, bad, caplog):
    watch, trainer = FiniteGradients(at_most=0.1), types.SimpleNamespace(current_epoch=3)
    watch.on_train_epoch_start(trainer, stack)
    for step in range(10):
        stack.zero_grad()
        scale = float("nan") if step < bad else 1.0
        (scale * stack.predictor(torch.ones(1, 2))).sum().backward()
        watch.on_before_optimizer_step(trainer, stack, None)
    if bad > 1:
        with pytest.raises(ValueError, match=r"not in 2 of 10 steps in epoch 3.*optim.optimizer"):
            watch.on_train_epoch_end(trainer, stack)
    else:
        watch.on_train_epoch_end(trainer, stack)
        assert ("1 of 10 steps" in caplog.text) == (bad == 1)
    assert stack.logged["gradient/not_finite"] == bad
