"""Sizes of the networks of the predictor."""

from typing import NamedTuple


class Sizes(NamedTuple):
    """Sizes of the networks, those of Trajectron++ by default, and the share of units dropped.

    `reach_m` is the distance at which the influence of another agent is halved, `fade_m` the
    distance over which it fades; see `Interaction`.
    """

    history: int = 32
    edge: int = 32
    future: int = 32
    decoder: int = 128
    dropout: float = 0.1
    reach_m: float = 15.0
    fade_m: float = 2.0
