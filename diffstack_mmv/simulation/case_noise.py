"""Random errors that belong to a case and an instant, whatever else is driven in its batch."""

from collections.abc import Sequence
from enum import IntEnum

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffstack_mmv.seeding import stream


class NoiseSource(IntEnum):
    """What the errors are of: those of two sources are independent, whatever their seeds."""

    PLANS = 0
    ACTUATORS = 1
    POSITIONS = 2
    VELOCITIES = 3
    EGO = 4


def case_noise(
    source: NoiseSource,
    case: Int[Tensor, "*b"],
    moment: Int[Tensor, "*b"],
    shape: Sequence[int],
    seed: int,
) -> Float[Tensor, "..."]:
    """Draw independent standard normal errors `*b *d`, float64, with a generator for every case.

    Draws of the same source, case, moment and seed are the same, whatever asks for them.

    Args:
        source: What the errors are of.
        case: Numbers of the cases.
        moment: What tells the draws of one case apart, as the number of a step.
        shape: What is drawn for each case, *d.
        seed: Of all draws; the same seed repeats them.
    """
    drawn = case.new_empty(*case.shape, *shape, dtype=torch.float64, device="cpu")
    rows = drawn.reshape(case.numel(), *shape)
    own = stream(seed, source)
    for row, number, instant in zip(rows, case.flatten(), moment.flatten(), strict=True):
        seeded = stream(stream(own, int(number)), int(instant))
        row.normal_(generator=torch.Generator().manual_seed(seeded))
    return drawn.to(case.device)


def milliseconds(time_s: Float[Tensor, "*b"]) -> Int[Tensor, "*b"]:
    """Number the draws by their instant in whole milliseconds."""
    return (1000 * time_s).round().long()
