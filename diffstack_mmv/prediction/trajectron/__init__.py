"""Trajectron++ with the dynamics of micro-mobility vehicles in its decoder."""

from diffstack_mmv.prediction.trajectron.jacobians import linearise, linearise_shared
from diffstack_mmv.prediction.trajectron.latent import Annealing
from diffstack_mmv.prediction.trajectron.model import Sizes, Trajectron
from diffstack_mmv.prediction.trajectron.site import Site

__all__ = [
    "Annealing",
    "Site",
    "Sizes",
    "Trajectron",
    "linearise",
    "linearise_shared",
]
