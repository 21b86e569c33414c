"""KIT two-wheeler recordings: bicycle, motorcycle and e-scooter with measured lean, 2 Hz."""

from data_converters.two_wheeler.dataset import TwoWheelerDataset

__all__ = ["TwoWheelerDataset"]
