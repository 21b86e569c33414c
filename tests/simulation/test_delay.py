"""Forecasts as they are from the time on at which a command acts."""

import pytest
import torch

from diffstack_mmv.dynamics import DiffKBM
from diffstack_mmv.simulation import DelayCompensation
from diffstack_mmv.types import Forecast
from diffstack_mmv.vehicles import load_vehicle


@pytest.mark.parametrize("decision_s", [0.1, 0.25, 0.5])
@pytest.mark.parametrize("step_s", [0.05, 0.1, 0.25])
def test_a_forecast_is_moved_by_the_delay_whatever_its_step(step_s, decision_s):
    """Of somebody who walks at (1, 0.5) m/s from the origin."""
    delay_s, steps = 0.1, 6
    delay = DelayCompensation(DiffKBM(load_vehicle("bicycle"), delay_s), decision_s)
    time = step_s * torch.arange(1, steps + delay.more_steps(step_s) + 1).double()
    path = (time.unsqueeze(-1) * torch.tensor([1.0, 0.5]).double()).expand(1, 1, 1, -1, 2)
    spread = time.view(-1, 1, 1) * torch.eye(2).double()
    given = Forecast(torch.zeros(1, 1, 1).double(), path, spread.expand(1, 1, 1, -1, 2, 2))
    later = delay.forecast(given, step_s)
    ahead = delay_s + step_s * torch.arange(1, steps + 1).double()
    assert torch.allclose(later.mean[0, 0, 0, :, 0], ahead)
    assert torch.allclose(later.mean[0, 0, 0, :, 1], 0.5 * ahead)
    # no surer than it was for that time
    assert (later.scale_tril[0, 0, 0, :, 0, 0] >= ahead - 1e-9).all()
