"""The encoding of an agent in its scene: history, neighbors, present motion and mode."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.checks import require_between
from diffstack_mmv.prediction.trajectron.agent_batch import (
    PEDESTRIAN,
    VEHICLE,
    AgentBatch,
)
from diffstack_mmv.prediction.trajectron.encoder import (
    SPEED_SCALE_MPS,
    TRACK_FEATURES,
    PerKind,
    track_features,
)
from diffstack_mmv.prediction.trajectron.interaction import Interaction
from diffstack_mmv.prediction.trajectron.memory import MaskedLSTM
from diffstack_mmv.prediction.trajectron.roughness import ORDERS, roughness
from diffstack_mmv.prediction.trajectron.site import Site
from diffstack_mmv.prediction.trajectron.sizes import Sizes
from diffstack_mmv.prediction.trajectron.start import START_FEATURES, start_features
from diffstack_mmv.types import Mode

MOTION_FEATURES = 4 + START_FEATURES


class SceneEncoder(nn.Module):
    """Context of every agent: history LSTM, interaction, fits to the track, mode, site.

    Args:
        dt_s: Length of one step in s.
        sizes: Sizes of the encodings of history and interaction, and the reach of the latter.
        site: Encoder of the place in the world; None: what is learned holds everywhere.
        rough: Whether it is told how noisy a track is, see `roughness`.

    Raises:
        ValueError: The share is no share, or a distance is not positive.
    """

    def __init__(
        self,
        dt_s: float,
        sizes: Sizes,
        site: Site | None = None,
        rough: bool = False,
    ) -> None:
        super().__init__()
        history, edge = sizes.history, sizes.edge
        require_between("dropout", sizes.dropout, 0.0, 0.9)
        self.dt_s = dt_s
        self.history = PerKind(
            {kind: MaskedLSTM(TRACK_FEATURES, history) for kind in (VEHICLE, PEDESTRIAN)}, history
        )
        self.interaction = Interaction(
            history, edge, sizes.reach_m, sizes.fade_m, sizes.dropout, sizes.detail_m
        )
        self.site = site
        self.rough = rough
        self.outputs = history + edge + MOTION_FEATURES + len(Mode)
        self.outputs += site.outputs if site is not None else 0
        self.outputs += len(ORDERS) if rough else 0

    def forward(
        self, rows: AgentBatch, agents: int, ego_only: bool = False
    ) -> Float[Tensor, "R c"]:
        """Context of each row; `agents` is the number of agents per scene.

        With `ego_only` the context of neighbors lacks their own neighbors.
        """
        now = rows.past.valid.shape[-1] - 1
        seen = track_features(rows.past, rows.velocity, self.dt_s, now)
        node = self.history(rows.kind, seen, rows.past.valid)
        around = self.interaction(rows, agents, node, ego_only)
        mode = nn.functional.one_hot(rows.past.mode, len(Mode)).to(node.dtype)
        site = [self.site(rows.place)] if self.site is not None else []
        motion = [rows.velocity / SPEED_SCALE_MPS, rows.acceleration, start_features(rows.starts)]
        noise = [roughness(rows.past)] if self.rough else []
        return torch.cat([node, around, *motion, mode, *site, *noise], -1)
