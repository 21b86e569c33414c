"""Autobike (Chalmers): a riderless bicycle with measured steering, speed, rates and position."""

from data_converters.autobike.dataset import AutobikeDataset

__all__ = ["AutobikeDataset"]
