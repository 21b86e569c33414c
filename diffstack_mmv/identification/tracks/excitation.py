"""How hard recorded tracks accelerate and brake."""

from collections.abc import Sequence

import torch

from diffstack_mmv.identification.tracks.segments import TrackSegment
from diffstack_mmv.vehicles import Limits

AVERAGED_S = 0.4  # accelerations of recorded tracks are means over that long


def share_beyond_limits(segments: Sequence[TrackSegment], limits: Limits, dt_s: float) -> float:
    """Share of the recorded samples whose acceleration along the track no command can give.

    Args:
        segments: The tracks.
        limits: Of the vehicle.
        dt_s: Step of the tracks.
    """
    lag = max(round(AVERAGED_S / dt_s), 1)
    along = torch.cat([(each.speed[lag:] - each.speed[:-lag]) / (lag * dt_s) for each in segments])
    low, high = limits.acceleration_mps2
    return float(((along < low) | (along > high)).double().mean())
