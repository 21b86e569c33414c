"""Trajectron++ with the dynamics of micro-mobility vehicles in its decoder."""

from diffstack_mmv.prediction.trajectron.latent import Annealing
from diffstack_mmv.prediction.trajectron.mixture import linearise, linearise_shared
from diffstack_mmv.prediction.trajectron.model import Sizes, Trajectron
from diffstack_mmv.prediction.trajectron.pedestrian import SingleIntegrator

__all__ = ["Annealing", "SingleIntegrator", "Sizes", "Trajectron", "linearise", "linearise_shared"]
