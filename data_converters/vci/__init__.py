"""Vehicle-crowd interaction, Ohio State: CITR (golf cart, experiments) and DUT (cars, campus)."""

from data_converters.vci.dataset import CitrDataset, DutDataset

__all__ = ["CitrDataset", "DutDataset"]
