"""Wheel positions are as uncertain as the wheelbase."""

from dataclasses import replace

import pytest

from diffstack_mmv.dynamics import DiffGM3, DiffKBM
from diffstack_mmv.identification import ParameterVector
from diffstack_mmv.identification.shooting.wheel_positions import (
    free_positions,
    with_uncertain_positions,
)
from diffstack_mmv.vehicles import load_vehicle


def test_positions_take_the_range_of_the_wheelbase(bicycle):
    scale = with_uncertain_positions(bicycle).parameters["length_scale"]
    assert scale.learn
    assert (scale.initial, scale.low, scale.high) == pytest.approx((1.0, 0.85, 1.15))


def test_range_of_its_own_stays():
    autobike = load_vehicle("autobike")
    assert with_uncertain_positions(autobike) is autobike


def test_positions_beside_a_known_wheelbase_stay_exact(bicycle):
    known = replace(bicycle, wheelbase=replace(bicycle.wheelbase, learn=False))
    assert with_uncertain_positions(known) is known
    model = DiffGM3(known)
    free_positions(model, known)
    assert "length_scale" not in ParameterVector(model.double(), known).names


def test_model_with_wheels_learns_their_positions(bicycle):
    spec = with_uncertain_positions(bicycle)
    wheeled, kinematic = DiffGM3(bicycle), DiffKBM(bicycle)
    for model in (wheeled, kinematic):
        free_positions(model, spec)
    assert "length_scale" in ParameterVector(wheeled.double(), spec).names
    assert ParameterVector(kinematic.double(), spec).names == ["wheelbase"]


def test_length_that_was_found_is_that_of_the_calibrated_vehicle(bicycle):
    spec = with_uncertain_positions(bicycle)
    longer = spec.with_values({"length_scale": 1.1}, "a test")
    axles = DiffGM3(longer).physical_parameters()["length_scale"]
    assert float(axles) == pytest.approx(1.1)
