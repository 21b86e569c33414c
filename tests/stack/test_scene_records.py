"""Records of samples for the page: plain numbers, who is unknown is None."""

import json

import numpy as np
import pytest

from diffstack_mmv.planning import PredictedGoal
from diffstack_mmv.reporting.html.scenes import planned_scene
from diffstack_mmv.stack import scene_records
from tests.stack.test_module import STEPS, batch_of, stack_of, without_future


def test_a_record_holds_what_the_stack_made_of_its_sample():
    batch, stack = without_future(batch_of(), 1, STEPS - 2), stack_of(PredictedGoal())
    output = stack(batch)
    records = scene_records(batch, output, ["first", "second"])
    # whatever reads JSON reads them, and the page plays them
    assert json.loads(json.dumps(records, allow_nan=False)) == records
    assert len(planned_scene(records[1])["frames"]) == len(planned_scene(records[1])["times"])
    plan = np.array(records[0]["plan"])[:, :2]
    assert plan == pytest.approx(output.plan.motion.position[0].detach().numpy(), abs=6e-4)
    assert [point is None for point in records[1]["ego"]["future"]].count(True) == 2
    seen = int(batch.neighbors_past.valid[0, :, -1].sum())
    assert len(records[0]["neighbors"]) == seen
    covariance = np.array(records[0]["prediction"]["covariance"])
    assert (covariance[..., 0] * covariance[..., 2] > covariance[..., 1] ** 2).all()
    assert sum(records[0]["prediction"]["weight"]) == pytest.approx(1.0, abs=5e-3)
