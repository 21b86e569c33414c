"""A training step on a device: the predictor asks the host for nothing, the plan for its end.

The meta device has shapes and no values. That all problems are finished is answered with yes;
whatever else waits is refused.
"""

from contextlib import nullcontext

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from diffstack_mmv.control import ILQR
from diffstack_mmv.planning import PredictedGoal
from diffstack_mmv.prediction import (
    ConstantTurnRateAcceleration,
    ConstantVelocity,
    KalmanConstantVelocity,
)
from diffstack_mmv.types import map_tensors
from tests.control.test_synchronisation import Sends, Waits
from tests.prediction.samples import DT_S, scene, trajectron
from tests.stack.test_module import batch_of, stack_of

HISTORY, STEPS = 3, 2  # every step asks alike


def without_autocast(patch):
    """The meta device has none."""
    patch.setattr(torch, "autocast", lambda *_, **__: nullcontext())


def on_meta(batch):
    return map_tensors(lambda field: field.to("meta"), batch)


@pytest.mark.parametrize("neighbors", [0, 3])
@pytest.mark.parametrize("options", [{}, {"neighbor_components": 0}, {"rough": True}])
def test_the_predictor_asks_for_nothing(options, neighbors, monkeypatch):
    without_autocast(monkeypatch)
    model = trajectron(horizon=STEPS, **options).to("meta")
    batch = on_meta(scene(batch=(4,), neighbors=neighbors, history=HISTORY, horizon=STEPS))
    with Waits() as waits, Sends():
        forecast, loss = model.predict_and_judge(batch)
        (loss.sum() + forecast.mean.sum()).backward()
    assert waits.seen == []


PREDICTORS = {
    "constant_velocity": lambda: ConstantVelocity(STEPS, DT_S),
    "ctra": lambda: ConstantTurnRateAcceleration(STEPS, DT_S),
    "kalman": lambda: KalmanConstantVelocity(STEPS, DT_S),
    "trajectron": lambda: trajectron(horizon=STEPS),
}


class Deterministic(TorchDispatchMode):
    """Notes what has no deterministic form on a GPU, and so would end a training there.

    Source: the documentation of `torch.use_deterministic_algorithms`, which a trainer asks for.
    """

    def __init__(self):
        super().__init__()
        self.refused = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = func.overloadpacket.__name__
        real = name in ("cumsum", "cumprod") and args[0].is_floating_point()
        if real or name in REFUSED:
            self.refused.append(name)
        return func(*args, **(kwargs or {}))


REFUSED = {"put", "put_", "histc", "bincount", "median", "kthvalue", "nll_loss2d_forward"}


@pytest.fixture(scope="module", params=PREDICTORS)
def step(request):
    """One step of training on the meta device, with a solver of one iteration: what it asked."""
    stack = stack_of(PredictedGoal(), PREDICTORS[request.param](), steps=STEPS).to("meta")
    stack.planner.solver = ILQR(max_iterations=1)
    stack.log_dict = lambda *_, **__: None
    batch = on_meta(batch_of(steps=STEPS))
    with pytest.MonkeyPatch.context() as patch, Deterministic() as known:
        without_autocast(patch)
        with Waits() as waits, Sends():
            stack.training_step(batch, 0).backward()
    return waits, known


def test_a_step_asks_for_nothing_but_whether_the_plan_is_finished(step):
    waits, _ = step
    assert waits.seen == ["_local_scalar_dense"]


def test_a_step_has_a_deterministic_form_on_a_gpu(step):
    _, known = step
    assert known.refused == []
