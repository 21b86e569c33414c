"""Evaluate a checkpoint per mode, beside its trivial baselines."""

from pathlib import Path

from hydra.utils import instantiate
from omegaconf import DictConfig

from diffstack_mmv.cli import command
from diffstack_mmv.reporting import summarise_modes, write_metrics, write_parquet
from diffstack_mmv.stack import SampleTable, load_stack
from diffstack_mmv.vehicles import config_folder


@command(config_folder(), "evaluate")
def main(config: DictConfig) -> None:
    """Score every window of a split; write tables and plots."""
    trained = load_stack(config.checkpoint, config.device, config.goal_source)
    windows = instantiate(config.data.module).dataset(config.split)
    table = SampleTable(windows, trained.stack, instantiate(config.baselines), config.batch_size)
    samples = table.fill()
    out = Path(config.out)
    write_parquet(out / "samples.parquet", samples)
    metrics = trained.header | {"data": config.data.name, "split": config.split}
    write_metrics(out, metrics | summarise_modes(samples, table.situations))
    if config.plots:
        table.draw(out / "plots")


if __name__ == "__main__":
    main()
