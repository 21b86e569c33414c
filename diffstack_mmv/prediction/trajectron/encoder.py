"""Encoders of what an agent did, and in training of what it will do."""

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from diffstack_mmv.geometry import direction, rotate
from diffstack_mmv.prediction.trajectron.rows import chosen
from diffstack_mmv.types import Tracks

POSITION_SCALE_M = 10.0
SPEED_SCALE_MPS = 5.0
TRACK_FEATURES = 10
DEVIATION_M = 0.3  # what a position deviates from a fit by, of order, at present
DEVIATION_MPS = 0.5  # and more for each second before and after


def track_features(
    tracks: Tracks, velocity: Float[Tensor, "*b 2"], dt_s: float, now: int
) -> Float[Tensor, "*b T 10"]:
    """Features of order one of tracks in their own frames, zero where not valid.

    Position, its deviation from the way of the fitted velocity, velocity, direction, yaw rate and
    validity. In the position alone what a rider does differently would be a few per cent.

    Args:
        tracks: Tracks in their own frames.
        velocity: Present velocity in m/s of the fit.
        dt_s: Length of one step in s.
        now: Number of the row that is the present; -1 if that is the one before the first.
    """
    motion = tracks.motion
    rows = torch.arange(tracks.valid.shape[-1], dtype=velocity.dtype, device=velocity.device)
    time_s = dt_s * (rows - now)
    deviation = motion.position - velocity.unsqueeze(-2) * time_s.unsqueeze(-1)
    width = DEVIATION_M + DEVIATION_MPS * time_s.abs()
    features = torch.cat(
        [
            motion.position / POSITION_SCALE_M,
            deviation / width.unsqueeze(-1),
            rotate(motion.velocity, motion.heading) / SPEED_SCALE_MPS,
            direction(motion.heading),
            motion.yaw_rate.unsqueeze(-1),
            torch.ones_like(motion.yaw_rate).unsqueeze(-1),
        ],
        -1,
    )
    return torch.where(tracks.valid.unsqueeze(-1), features, torch.zeros_like(features))


class PerKind(nn.Module):
    """One network per kind of agent, each applied to the rows of its kind.

    Args:
        networks: The networks by the number of their kind; all have the same output size.
        outputs: That size.
    """

    def __init__(self, networks: dict[int, nn.Module], outputs: int) -> None:
        super().__init__()
        self.networks = nn.ModuleDict({str(kind): network for kind, network in networks.items()})
        self.outputs = outputs

    def forward(self, kind: Int[Tensor, " R"], *inputs: Tensor) -> Float[Tensor, "R o"]:
        """Apply the network of each row's kind; rows of a kind without a network become zero."""
        result = inputs[0].new_zeros(len(kind), self.outputs)
        for name, network in self.networks.items():
            rows = chosen(kind == int(name))
            if rows.kept is None and len(rows.index) == len(kind) > 0:
                return network(*inputs)
            if len(rows.index) > 0:
                result = rows.put(result, network(*(tensor[rows.index] for tensor in inputs)))
        return result


def perceptron(sizes: Sequence[int], dropout: float = 0.0) -> nn.Sequential:
    """Linear layers of the given sizes with ELU and dropout between them."""
    layers: list[nn.Module] = []
    for number, (inputs, outputs) in enumerate(zip(sizes[:-1], sizes[1:], strict=True)):
        if number > 0:
            layers += [nn.ELU(), nn.Dropout(dropout)]
        layers.append(nn.Linear(inputs, outputs))
    return nn.Sequential(*layers)
