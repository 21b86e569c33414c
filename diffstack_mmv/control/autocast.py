"""Autocast around a solve, which is left alone by it."""

import torch


def autocasts(device: torch.device) -> bool:
    """Whether products of matrices on this device are computed in lower precision now."""
    kind = device.type
    # some devices, as the one of shapes alone, know no autocast, and refuse the question
    return torch.amp.is_autocast_available(kind) and torch.is_autocast_enabled(kind)
