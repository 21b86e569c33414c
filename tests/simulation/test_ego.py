"""A vehicle whose motion is measured on board and estimated, with a bent steering head."""

import math

import pytest
import torch

from diffstack_mmv.dynamics import DiffKBM, ExtendedUnicycle
from diffstack_mmv.geometry import wrap_angle
from diffstack_mmv.identification.measured import InstrumentPriors, MeasurementNoise, ego_estimator
from diffstack_mmv.simulation import (
    Actuation,
    BlindDriver,
    EgoInstruments,
    EstimatingController,
    VehicleRobot,
    ZeroOrderHold,
    drive,
)
from diffstack_mmv.types import EgoMeasurement, Motion, map_tensors
from diffstack_mmv.vehicles import load_vehicle

SPEC, BENT_RAD = load_vehicle("bicycle"), math.radians(4)


def held():
    return ZeroOrderHold(DiffKBM(SPEC, dt_s=0.05), 5)


def estimator_of(position_m=0.02, horizon_s=2.0, with_gyro=False):
    noise = MeasurementNoise(along_m=position_m, across_m=position_m, knot_steps=2)
    return ego_estimator(held(), SPEC, noise, InstrumentPriors(), horizon_s, with_gyro, 3)


def end_of_blind_drive(world_with, scene, estimating):
    """How far aside of the straight way, and what is believed of the head."""
    robot = VehicleRobot(
        DiffKBM(SPEC, dt_s=0.01), Actuation(bias=(0.0, BENT_RAD), speed_max_mps=3.0)
    )
    blind = BlindDriver(held())
    driver = EstimatingController(blind, estimator_of(horizon_s=1.25), EgoInstruments(), held())
    driven = drive(world_with(robot, limit_s=4.0), scene, driver if estimating else blind)
    way = driven.record.motion.position[:, -1] - driven.record.motion.position[:, 0]
    aside = way[:, 0].abs() / way.norm(dim=-1)
    return aside, driver.diagnosis(driven.controller_state) if estimating else {}


@pytest.mark.slow
def test_a_bent_head_is_found_and_the_commands_make_up_for_it(world_with, scene_with):
    scene = map_tensors(lambda entry: entry[None], scene_with((6.0, 0.0), (6.0, 0.0)))
    aside, _ = end_of_blind_drive(world_with, scene, estimating=False)
    better, told = end_of_blind_drive(world_with, scene, estimating=True)
    assert float(aside) > 0.25 > 0.12 > float(better)
    assert float(told["steer_offset"]) == pytest.approx(BENT_RAD, abs=math.radians(1))


@pytest.mark.parametrize("with_gyro", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_vehicle_that_stands_is_believed_to_point_where_it_did(with_gyro):
    estimator, course = estimator_of(horizon_s=1.25, with_gyro=with_gyro), torch.tensor([2.0])
    instruments = EgoInstruments(yaw_rate_radps=0.01 if with_gyro else None)
    stands = Motion(torch.zeros(1, 2), course, torch.zeros(1, 2), torch.zeros(1))

    def measured(step):
        return instruments(
            stands, stands, torch.full((1,), 0.2), torch.tensor([7]), torch.tensor([0.25 * step])
        )

    horizon = estimator.init(measured(0), course)
    for step in range(1, 7):
        found = estimator(horizon, measured(step))
        horizon = found.horizon
    assert float(wrap_angle(found.estimate.motion.heading - course)) == pytest.approx(0, abs=0.06)
    assert float(found.estimate.motion.position.norm()) < 0.05
    assert float(found.estimate.motion.velocity.norm()) < 0.05
    assert all(part.isfinite().all() for part in found.estimate.motion)


def test_errors_of_the_instruments_belong_to_seed_case_and_time():
    def measured(seed, time_s, cases=(3, 4), **settings) -> EgoMeasurement:
        moves = Motion(*(torch.ones(2, *shape) for shape in ((2,), (), (2,), ())))
        case, time = torch.tensor(cases), torch.full((2,), time_s)
        return EgoInstruments(seed=seed, **settings)(moves, moves, torch.zeros(2), case, time)

    one, same, later, other = (
        measured(0, 1.0),
        measured(0, 1.0),
        measured(0, 1.25),
        measured(1, 1.0),
    )
    assert torch.equal(one.position, same.position)
    assert not torch.equal(one.position, later.position)
    assert not torch.equal(one.position, other.position)
    assert torch.equal(one.position, measured(0, 1.0, cases=(4, 3)).position.flip(0))
    assert one.yaw_rate.isnan().all()
    exact = measured(0, 1.0, position_m=0.0, speed_mps=0.0, yaw_rate_radps=0.0)
    assert (exact.position == 1).all()
    assert (exact.yaw_rate == 1).all()


def test_what_is_not_steered_by_an_angle_is_refused():
    with pytest.raises(ValueError, match="model.*steering angle"):
        EstimatingController(
            BlindDriver(held()), estimator_of(), EgoInstruments(), ExtendedUnicycle(SPEC)
        )
    with pytest.raises(ValueError, match="position_m"):
        EgoInstruments(position_m=-1.0)
