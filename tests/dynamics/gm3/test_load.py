"""Loads in a turn of wheels that stand unevenly, or three abreast."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from diffstack_mmv.dynamics import DiffGM3
from diffstack_mmv.types import GRAVITY
from diffstack_mmv.vehicles import VehicleSpec, load_vehicle
from tests.dynamics.gm3.test_parts import loads

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"


def lopsided() -> VehicleSpec:
    """A tricycle whose right wheel stands nearer to the middle, and so carries more."""
    spec = load_vehicle("tricycle")
    front, left, right = spec.wheels
    return replace(spec, wheels=(front, left, replace(right, y_m=0.6 * right.y_m)))


def three_abreast() -> VehicleSpec:
    """Five wheels, the last one between the two in the middle."""
    spec = load_vehicle(EXAMPLES / "five_wheeled.yaml")
    *others, tail = spec.wheels
    return replace(spec, wheels=(*others, replace(tail, x_m=others[-1].x_m)))


def turning(spec: VehicleSpec, lateral: float) -> Tensor:
    """Loads in N as shares of the weight, at a lateral acceleration in m/s²."""
    found = loads(DiffGM3(spec).double(), torch.zeros(1).double(), torch.tensor([lateral]).double())
    return found[:, 0].detach() / (spec.mass_kg * GRAVITY)


@pytest.mark.parametrize(
    ("lateral", "least"), [(60.0, 0.0), (-60.0, 0.163)], ids=["to the left", "to the right"]
)
def test_the_lighter_wheel_of_an_axle_lifts_before_any_load_is_negative(
    lateral: float, least: float
) -> None:
    found = turning(lopsided(), lateral)
    assert float(found.min()) == pytest.approx(least, abs=1e-3)
    assert float(found.sum()) == pytest.approx(1.0)


@pytest.mark.parametrize("spec", [lopsided(), three_abreast()], ids=["lopsided", "three abreast"])
@pytest.mark.parametrize("lateral", [-0.1, 0.1])
def test_a_slight_turn_moves_the_whole_rolling_moment_across(
    spec: VehicleSpec, lateral: float
) -> None:
    moved = (turning(spec, lateral) - turning(spec, 0.0)) * spec.mass_kg * GRAVITY
    moment = moved @ torch.tensor(spec.per_wheel("y_m")).double()
    assert float(moment) == pytest.approx(-spec.mass_kg * spec.height_m * lateral, rel=1e-3)


@pytest.mark.parametrize("lateral", [-60.0, -2.0, 2.0, 60.0])
def test_a_wheel_in_the_middle_of_its_axle_keeps_its_load(lateral: float) -> None:
    found, before = turning(three_abreast(), lateral), turning(three_abreast(), 0.0)
    assert float(found[-1]) == pytest.approx(float(before[-1]))
    assert float(found.min()) > -1e-9
