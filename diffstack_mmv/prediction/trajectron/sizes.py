"""Sizes of the networks of the predictor, and what else they are built with."""

from typing import NamedTuple


class Sizes(NamedTuple):
    """Sizes of the networks, those of Trajectron++ by default, with their dropout and reach.

    Attributes:
        history: Units of the LSTM over an agent's past, the size of its encoding.
        edge: Units of the encoding of a neighbor, and of all neighbors together.
        future: Units of the LSTM over an agent's future, which only training sees.
        decoder: Units of the GRU that emits controls.
        dropout: Share of units dropped in training, in [0, 0.9]: in the encoders of neighbors, and
            of what the decoder is told of the scene.
        reach_m: Distance in m at which the influence of a neighbor is halved, see `Interaction`.
        fade_m: Length in m of the fading around `reach_m`: at 4 `fade_m` beyond it, 2 % are left.
        detail_m: Length in m up to which places of neighbors are told apart, with their closest
            approach, see `edge_features`; None: in units of 10 m, as earlier checkpoints.
    """

    history: int = 32
    edge: int = 32
    future: int = 32
    decoder: int = 128
    dropout: float = 0.1
    reach_m: float = 15.0
    fade_m: float = 2.0
    detail_m: float | None = None
