"""A training step on a device: the predictor asks the host for nothing, the plan for its end.

The meta device has shapes and no values. That all problems are finished is answered with yes;
whatever else waits is refused.
"""

from contextlib import nullcontext

import pytest
import torch

from diffstack_mmv.control import ILQR
from diffstack_mmv.planning import PredictedGoal
from diffstack_mmv.types import map_tensors
from tests.control.test_synchronisation import Sends, Waits
from tests.prediction.samples import scene, trajectron
from tests.stack.test_module import batch_of, stack_of


@pytest.fixture(autouse=True)
def unasked(monkeypatch):
    """The arguments of a problem are asked once, before the iterations; meta has no autocast."""
    monkeypatch.setattr("diffstack_mmv.control.ilqr.check_problem", lambda *_: None)
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: nullcontext())


def on_meta(batch):
    return map_tensors(lambda field: field.to("meta"), batch)


@pytest.mark.parametrize("neighbors", [0, 3])
@pytest.mark.parametrize("options", [{}, {"neighbor_components": 0}, {"rough": True}])
def test_the_predictor_asks_for_nothing(options, neighbors):
    model = trajectron(**options).to("meta")
    batch = on_meta(scene(batch=(4,), neighbors=neighbors))
    with Waits() as waits, Sends():
        forecast, loss = model.predict_and_judge(batch)
        (loss.sum() + forecast.mean.sum()).backward()
    assert waits.seen == []


def test_the_plan_asks_for_nothing_but_whether_it_is_finished():
    stack, batch = stack_of(PredictedGoal()).to("meta"), on_meta(batch_of())
    stack.planner.solver = ILQR(max_iterations=1)
    stack.log_dict = lambda *_, **__: None
    with Waits() as waits, Sends():
        stack.training_step(batch, 0).backward()
    assert waits.seen == ["_local_scalar_dense"]
