"""What `side_by_side` takes from the drives that it shows."""

from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf

import diffstack_mmv.commands.cli  # noqa: F401  registers the resolvers
from dmmv_conventions.configs import config_folder
from scripts.side_by_side import robot_of


@pytest.fixture(scope="module")
def settings():
    """Parts of the configuration of a drive with the box of a vehicle, as a file holds them."""
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("navigate", ["footprint=vehicle"], return_hydra_config=True)
        HydraConfig.instance().set_config(config)
        parts = ("controller", "baselines", "robot")
        return {name: OmegaConf.to_container(config[name], resolve=True) for name in parts}


@pytest.mark.parametrize(
    ("name", "corners"),
    [("diffmpc", 4), ("mppi", 4), ("orca", 48), ("straight", 48)],
)
def test_a_massless_baseline_is_drawn_as_the_disc_that_it_drove(settings, name, corners) -> None:
    outline = robot_of(Path("drive", "episodes", name), settings).footprint.outline()
    assert len(outline) == corners
