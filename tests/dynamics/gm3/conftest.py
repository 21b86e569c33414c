"""Reference vectors of the GM3 equations, and models built on their parameter sets."""

import json

import numpy as np
import pytest
import torch

from diffstack_mmv.dynamics.gm3 import DiffGM3
from diffstack_mmv.vehicles import VehicleSpec

VEHICLES = ["bicycle", "scooter", "tricycle", "wheelchair", "cart", "skateboard"]


class Reference:
    """Read the vectors of a folder as float64 tensors."""

    def __init__(self, folder):
        self.folder = folder
        self.entries = json.loads((folder / "vehicles.json").read_text())

    def load(self, name):
        with np.load(self.folder / f"{name}.npz") as stored:
            return {key: stored[key] for key in stored.files}

    def spec(self, vehicle, brake=None):
        entry = json.loads(json.dumps(self.entries[vehicle]))
        if brake is not None:
            entry["wheels"]["brake"] = list(brake)
        return VehicleSpec.from_reference(entry)

    def model(self, vehicle, **settings):
        return DiffGM3(self.spec(vehicle), **settings).double().requires_grad_(False)


@pytest.fixture(scope="session")
def reference(shared):
    return Reference(shared / "reference" / "gm3")


@pytest.fixture(scope="session")
def tires(reference):
    return {key: torch.as_tensor(value) for key, value in reference.load("tyre").items()}


@pytest.fixture(scope="session")
def helpers(reference):
    return {key: torch.as_tensor(value) for key, value in reference.load("helpers").items()}


@pytest.fixture(scope="session")
def sides(reference):
    return {key: torch.as_tensor(value) for key, value in reference.load("rhs").items()}
