"""Tables of your own, CSV or Parquet: columns, units and types are named in the configuration."""

from data_converters.tables.columns import TableColumns
from data_converters.tables.dataset import TableDataset
from data_converters.tables.units import TableUnits

__all__ = ["TableColumns", "TableDataset", "TableUnits"]
