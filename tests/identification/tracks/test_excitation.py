"""How hard tracks accelerate."""

import torch

from diffstack_mmv.identification import TrackSegment, share_beyond_limits


def test_harder_riding_than_the_limits_allow_is_counted(bicycle):
    time_s = 0.1 * torch.arange(41)
    line = torch.stack([time_s, time_s], -1)
    speed = 2.0 + torch.cat([torch.zeros(21), 8.0 * time_s[:20]])
    hard = TrackSegment("a@0.0s", line, time_s, speed)
    assert 0.4 < share_beyond_limits([hard], bicycle.limits, 0.1) < 0.55
    assert share_beyond_limits([hard._replace(speed=time_s)], bicycle.limits, 0.1) == 0.0
