"""Several trained predictors as one."""

import math
from collections.abc import Sequence

import torch
from torch import nn

from diffstack_mmv.checks import require
from diffstack_mmv.prediction.base import GaussianRollout, Predictor
from diffstack_mmv.types import Forecast, StackBatch, Tracks


class Ensemble(Predictor):
    """The mixture of what several predictors forecast, each of them as probable as the others.

    Source: Lakshminarayanan et al., Simple and Scalable Predictive Uncertainty Estimation using
    Deep Ensembles (NeurIPS 2017).

    Args:
        members: Predictors of one horizon and step; they may differ in everything else.

    Raises:
        ValueError: There is none, or they differ in horizon or step.
    """

    def __init__(self, members: Sequence[Predictor]) -> None:
        require(len(members) > 0, "members", "hold at least one predictor", "none")
        horizons = {(member.horizon_steps, member.dt_s) for member in members}
        remedy = "Train them with one `horizon_s` and `dt_s`."
        told = sorted(horizons)
        require(len(horizons) == 1, "members", "have one horizon and step", told, "", remedy)
        super().__init__(*horizons.pop())
        self.members = nn.ModuleList(members)
        self.forecast_neighbors = all(member.forecast_neighbors for member in members)

    def forward(self, past: Tracks, neighbors: Tracks) -> Forecast:
        """Components of all members, `*b 1+N`."""
        return _mixed([member(past, neighbors) for member in self.members])

    def predict(self, batch: StackBatch) -> Forecast:
        """Components of all members, `B 1+N`."""
        return _mixed([member.predict(batch) for member in self._predictors()])

    def compile_kernels(self, moments: GaussianRollout) -> None:
        """Have expensive parts of each member compiled at their next use."""
        for member in self._predictors():
            member.compile_kernels(moments)

    def _predictors(self) -> list[Predictor]:
        return [member for member in self.members if isinstance(member, Predictor)]


def _mixed(forecasts: Sequence[Forecast]) -> Forecast:
    """One mixture, to which each forecast adds its components with the same probability."""
    share = math.log(len(forecasts))
    return Forecast(
        torch.cat([each.log_weight - share for each in forecasts], -1),
        torch.cat([each.mean for each in forecasts], -3),
        torch.cat([each.scale_tril for each in forecasts], -4),
    )
