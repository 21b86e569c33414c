"""Learning rates that grow with the number of processes."""

import pytest
import torch
from torch import distributed

from diffstack_mmv.stack import ScaledByProcesses


@pytest.mark.parametrize(("processes", "exponent", "factor"), [(1, 0.5, 1), (4, 0.5, 2), (4, 1, 4)])
def test_rate_grows_with_the_processes(processes, exponent, factor, monkeypatch):
    monkeypatch.setattr(distributed, "is_initialized", lambda: processes > 1)
    monkeypatch.setattr(distributed, "get_world_size", lambda: processes)
    made = ScaledByProcesses(torch.optim.SGD, 0.1, exponent)
    optimizer = made(params=[torch.nn.Parameter(torch.zeros(1))])
    assert optimizer.param_groups[0]["lr"] == pytest.approx(0.1 * factor)
