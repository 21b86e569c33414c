"""A model with its tracks, and the vehicle and motions that come out of it."""

from dataclasses import replace

import pytest

from diffstack_mmv.dynamics import DiffKBM
from diffstack_mmv.identification import IdentificationProblem, Identifier, TrackingSettings
from diffstack_mmv.vehicles import load_vehicle, save_vehicle
from tests.identification.conftest import LAZY, double_precision, synthetic_problem


@pytest.fixture(scope="module")
def identified():
    with double_precision():
        setup = synthetic_problem("kbm", {"wheelbase": 1.15})
        return setup, Identifier(starts=0)(setup.simulator, setup.data)


def test_calibrated_vehicle_is_a_vehicle_again(identified, tmp_path):
    setup, found = identified
    spec = load_vehicle("bicycle")
    save_vehicle(setup.calibrated(spec, found, "a test"), tmp_path / "v.yaml", {"tracks": 3})
    again = load_vehicle(tmp_path / "v.yaml")
    estimate = float(setup.simulator.parameters.values(found.after.theta))
    assert again.wheelbase.initial == pytest.approx(estimate, rel=1e-9)
    assert again.provenance["tracks"] == 3
    assert again.parameters == spec.parameters


def test_fitted_motions_follow_the_tracks(identified):
    setup, found = identified
    for row in setup.fitted_motions(found):
        assert row.position.shape == row.segment.position.shape
        assert len(row.controls) == len(row.position) - 1
        assert float((row.position - row.segment.position).norm(dim=-1).max()) < 0.15


def test_vehicle_with_nothing_to_learn_is_refused(bicycle):
    setup = synthetic_problem("kbm", {}, manoeuvres=LAZY, known=False)
    spec = replace(bicycle, wheelbase=replace(bicycle.wheelbase, learn=False))
    with pytest.raises(ValueError, match="`vehicle` must have parameters marked `learn: true`"):
        IdentificationProblem.of(DiffKBM(spec), spec, setup.split, TrackingSettings())


def test_chosen_parameters_alone_move():
    setup = synthetic_problem("gm3", {}, manoeuvres=LAZY, parameters=["yaw_damping"])
    assert setup.simulator.parameters.names == ["yaw_damping"]
