"""Trajectron++ with the dynamics of micro-mobility vehicles in its decoder."""

from diffstack_mmv.prediction.trajectron.jacobians import linearise, linearise_shared
from diffstack_mmv.prediction.trajectron.latent import Annealing
from diffstack_mmv.prediction.trajectron.model import Trajectron
from diffstack_mmv.prediction.trajectron.site import Site
from diffstack_mmv.prediction.trajectron.sizes import Sizes

__all__ = [
    "Annealing",
    "Site",
    "Sizes",
    "Trajectron",
    "linearise",
    "linearise_shared",
]
