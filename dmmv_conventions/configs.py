"""Where the configuration groups of the command lines lie."""

from importlib.resources import files
from pathlib import Path


def config_folder() -> Path:
    """Folder of the configuration groups: beside the packages in a checkout, else installed.

    Raises:
        FileNotFoundError: Neither exists.
    """
    beside = Path(__file__).resolve().parents[1] / "configs"
    if (beside / "vehicle").is_dir():
        return beside
    try:
        return Path(str(files("diffstack_mmv_configs")))
    except ModuleNotFoundError as missing:
        raise FileNotFoundError(
            f"No configuration folder: neither {beside} nor the installed package."
        ) from missing
