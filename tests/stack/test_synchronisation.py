"""A training step on a device: what it asks the host does not grow with its steps or agents.

The meta device has shapes and no values. Which agents are present is answered with all of them,
and that all problems are finished with yes; whatever else waits is refused.
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


class AllPresent(Waits):
    """Answers which ones with all."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        if func.overloadpacket.__name__ == "nonzero" and args[0].device.type == "meta":
            self.seen.append("nonzero")
            return torch.empty(args[0].numel(), args[0].dim(), dtype=torch.long, device="meta")
        return super().__torch_dispatch__(func, types, args, kwargs)


@pytest.fixture(autouse=True)
def unasked(monkeypatch):
    """The arguments of a problem are asked once, before the iterations; meta has no autocast."""
    monkeypatch.setattr("diffstack_mmv.control.ilqr.check_problem", lambda *_: None)
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: nullcontext())


def on_meta(batch):
    return map_tensors(lambda field: field.to("meta"), batch)


def waits_of_prediction(neighbors, horizon):
    model = trajectron(horizon=horizon).to("meta")
    batch = on_meta(scene(batch=(4,), neighbors=neighbors, horizon=horizon))
    with AllPresent() as waits, Sends():
        forecast, loss = model.predict_and_judge(batch)
        (loss.sum() + forecast.mean.sum()).backward()
    return waits.seen


def test_the_predictor_asks_as_often_for_a_long_horizon_and_many_agents_as_for_few():
    few, many = waits_of_prediction(2, 3), waits_of_prediction(5, 9)
    assert sorted(few) == sorted(many)
    assert few.count("_local_scalar_dense") <= 1


def test_the_plan_asks_for_nothing_but_whether_it_is_finished():
    stack, batch = stack_of(PredictedGoal()).to("meta"), on_meta(batch_of())
    stack.planner.solver = ILQR(max_iterations=1)
    stack.log_dict = lambda *_, **__: None
    with AllPresent() as waits, Sends():
        stack.training_step(batch, 0).backward()
    assert waits.seen == ["_local_scalar_dense"]
