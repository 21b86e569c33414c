"""Stanford Drone Dataset: bikers, skaters, carts, cars and pedestrians on a campus."""

from data_converters.sdd.dataset import SddDataset

__all__ = ["SddDataset"]
