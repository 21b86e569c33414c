"""Parts of a drive, each from a file of `configs/`, built without the command line."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from diffstack_mmv.checks import require
from dmmv_conventions.config_files import factory, interpolations, settings_of
from dmmv_conventions.configs import config_folder

HANDED: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        "scenario": frozenset(),
        "crowd": frozenset({"seed"}),
        "controller": frozenset(
            {
                *("dt_s", "seed", "compile", "cruise_mps", "model", "actuate", "people", "cost"),
                *("constraints", "actual", "believed", "vehicle", "known_delay_s"),
            }
        ),
        "people": frozenset({"dt_s", "seed"}),
        "cost": frozenset({"turning_radius_m"}),
        "footprint": frozenset({"actual"}),
        "sensing": frozenset({"seed"}),
    }
)
"""What a file of a configuration group is handed."""


def left_open(group: str, name: str) -> list[str]:
    """Names of what a file of a configuration group leaves to be handed, each once.

    Raises:
        ValueError: There is no such file.
    """
    return list(dict.fromkeys(interpolations(settings_of(name, config_folder() / group))))


def require_part(group: str, name: str) -> None:
    """Refuse what is no file of a configuration group, or for the command line alone.

    Raises:
        ValueError: There is no such file, it describes several parts, or it needs more than it is
            `HANDED`.
    """
    remedy = "Use the command line, dmmv-navigate."
    single = "_target_" in settings_of(name, config_folder() / group)
    require(single, group, "describe one part", name, "", remedy)
    lacking = [each for each in left_open(group, name) if each not in HANDED[group]]
    told = f"{name}, which needs {' and '.join(lacking)}"
    require(not lacking, group, "need nothing that the command line alone knows", told, "", remedy)


def built_part(group: str, name: str, given: Mapping[str, Any]) -> Any:
    """What a file of a configuration group describes.

    Args:
        group: The group, which is the folder of the file.
        name: Name of the file without its ending.
        given: What it is handed, by name.

    Raises:
        ValueError: There is no such file, or it needs what is not given.
    """
    return factory(settings_of(name, config_folder() / group), given)()
