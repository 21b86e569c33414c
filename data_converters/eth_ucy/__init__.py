"""ETH and UCY pedestrians, leave one scene out: the benchmark of prediction."""

from data_converters.eth_ucy.dataset import EthUcyDataset

__all__ = ["EthUcyDataset"]
