"""TH-AB VRU tracks: cyclists and pedestrians, one file per track."""

from data_converters.thab.dataset import ThabVruDataset

__all__ = ["ThabVruDataset"]
