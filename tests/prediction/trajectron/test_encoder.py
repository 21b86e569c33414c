"""Encoders of tracks."""

import pytest
import torch
from torch import nn

from diffstack_mmv.prediction.trajectron.encoder import PerKind, track_features
from diffstack_mmv.prediction.trajectron.memory import MaskedLSTM
from diffstack_mmv.types import Motion, Tracks


def test_masked_lstm_without_gaps_is_an_lstm():
    masked, plain = MaskedLSTM(3, 5), nn.LSTM(3, 5, batch_first=True)
    for name, parameter in masked.cell.named_parameters():
        getattr(plain, f"{name}_l0").data.copy_(parameter)
    features = torch.randn(4, 7, 3)
    valid = torch.ones(4, 7, dtype=torch.bool)
    assert torch.allclose(masked(features, valid), plain(features)[0][:, -1], atol=1e-6)


def test_masked_lstm_of_a_late_agent_is_that_of_its_rows_alone():
    masked, features = MaskedLSTM(3, 5), torch.randn(4, 7, 3)
    valid = torch.arange(7).expand(4, 7) >= 3
    expected = masked(features[:, 3:], valid[:, 3:])
    features[:, :3] = torch.nan_to_num(torch.full_like(features[:, :3], torch.inf))
    assert torch.allclose(masked(features, valid), expected)


@pytest.mark.parametrize(("dtype", "rounding"), [(torch.float32, 1e-6), (torch.float64, 1e-14)])
def test_who_goes_on_as_fitted_deviates_by_nothing(dtype, rounding):
    velocity = torch.tensor([[3.1, -0.7]], dtype=dtype)
    for now in (6, -1):
        time = 0.1 * (torch.arange(7, dtype=dtype) - now)
        still = torch.zeros(1, 7, dtype=dtype)
        motion = Motion(time[:, None] * velocity, still, torch.zeros(1, 7, 2, dtype=dtype), still)
        motion = motion._replace(position=motion.position.unsqueeze(0))
        valid = torch.ones(1, 7, dtype=torch.bool)
        gone = Tracks(motion, torch.ones(1, 2, dtype=dtype), torch.ones(1, dtype=torch.long), valid)
        features = track_features(gone, velocity, 0.1, now)
        assert features.dtype == dtype
        assert features[..., 2:4].abs().max() <= rounding


def test_each_kind_has_its_network():
    networks = {1: nn.Linear(2, 3), 2: nn.Linear(2, 3)}
    kind, inputs = torch.tensor([2, 1, 2, 7]), torch.randn(4, 2)
    outputs = PerKind(networks, 3)(kind, inputs)
    assert torch.allclose(outputs[1], networks[1](inputs[1]))
    assert torch.allclose(outputs[0], networks[2](inputs[0]))
    assert outputs[3].abs().max() == 0
