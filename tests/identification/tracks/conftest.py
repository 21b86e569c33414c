"""Tracks of vehicles that drive along circles."""

import torch

from diffstack_mmv.identification import Recordings, SegmentSettings, cut_tracks
from diffstack_mmv.types import Motion

SETTINGS = SegmentSettings(min_s=2.0, max_s=4.0, trim_s=0.5)


def circling(seconds, speed=3.0, yaw_rate=0.0):
    time = 0.1 * torch.arange(round(seconds * 10) + 1)
    heading = torch.remainder(yaw_rate * time + torch.pi, 2 * torch.pi) - torch.pi
    step = 0.1 * speed * torch.stack([heading.cos(), heading.sin()], -1)
    velocity = torch.stack([torch.full_like(time, speed), torch.zeros_like(time)], -1)
    return Motion(step.cumsum(0), heading, velocity, torch.full_like(time, yaw_rate))


def cut(tracks, **measured):
    """Segments of tracks, with what was measured beside them."""
    return cut_tracks(Recordings(tracks, **measured), SETTINGS)
