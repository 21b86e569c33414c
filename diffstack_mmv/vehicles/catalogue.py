"""The vehicles that come with the package, and vehicles in files of one's own."""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from diffstack_mmv.vehicles.reading import config_from_spec
from diffstack_mmv.vehicles.spec import VehicleSpec
from dmmv_conventions.checks import did_you_mean, message
from dmmv_conventions.config_files import names_in
from dmmv_conventions.configs import config_folder
from dmmv_conventions.disk import replacing
from dmmv_conventions.yaml_files import read_mapping, to_yaml


def vehicle_names() -> list[str]:
    """Names of the vehicles that come with the package, sorted."""
    return names_in(config_folder() / "vehicle")


def load_vehicle(name_or_path: str | Path) -> VehicleSpec:
    """Load a vehicle by its name ("bicycle", "calibrated/bicycle"), or from a YAML file.

    Raises:
        ValueError: The name is unknown, the file is missing or no YAML, or its content is no
            possible vehicle.
    """
    text = str(name_or_path)
    is_name = "/" not in text and os.sep not in text and not text.endswith((".yaml", ".yml"))
    shipped = config_folder() / "vehicle" / f"{text}.yaml"
    path = shipped if is_name or shipped.is_file() else Path(name_or_path)
    if not path.is_file():
        wanted = f"be one of {', '.join(vehicle_names())}, or the path of a YAML file"
        remedy = did_you_mean(text, vehicle_names()) if is_name else "There is no such file."
        raise ValueError(message("vehicle", wanted, repr(text), "", remedy))
    content = read_mapping(path, "vehicle")
    try:
        return VehicleSpec.from_config(content)
    except ValueError as problem:
        raise ValueError(f"{problem} (file {path})") from problem


def save_vehicle(
    spec: VehicleSpec, path: str | Path, provenance: Mapping[str, Any] | None = None
) -> None:
    """Write a vehicle as YAML that `load_vehicle` reads back, all or nothing.

    Args:
        spec: The vehicle, e.g. with calibrated parameters (`VehicleSpec.with_values`).
        path: File to write; it is replaced in one go.
        provenance: How the numbers came about (data, losses, date, seed), kept in the file.

    Raises:
        OSError: The file cannot be written.
    """
    kept = replace(spec, provenance=dict(provenance)) if provenance else spec
    with replacing(Path(path)) as unfinished:
        unfinished.write_text(to_yaml(config_from_spec(kept)), encoding="utf-8")
