"""Noise belongs to a case and an instant: a case goes the same way whatever is driven beside it."""

import dataclasses

import pytest
import torch
from hydra.utils import instantiate

from diffstack_mmv.dynamics import DiffKBM
from diffstack_mmv.simulation import (
    Actuation,
    CircleCrossing,
    LimitedSensing,
    VehicleRobot,
    drive,
)
from diffstack_mmv.simulation.case_noise import NoiseSource, case_noise, milliseconds
from diffstack_mmv.vehicles import load_vehicle
from tests.simulation.conftest import composed_navigate

NOISY = LimitedSensing(position_noise_m=0.1, velocity_noise_mps=0.1)


def test_a_disturbed_case_is_repeated_alone(world_with):
    robot = VehicleRobot(DiffKBM(load_vehicle("bicycle"), dt_s=0.01), Actuation(noise=(0.2, 0.05)))
    world = dataclasses.replace(world_with(robot, limit_s=1.5), sensing=NOISY)
    config = composed_navigate("controller=mppi", "controller.samples=8")
    controller = instantiate(config.controller)

    def path(numbers):
        scene = CircleCrossing(robot_radius_m=0.3).cases("val", numbers)
        return drive(world, scene, controller).record.motion.position

    assert torch.allclose(path([3, 7])[1], path([7])[0], atol=1e-6)
    assert torch.allclose(path([7, 3])[0], path([7])[0], atol=1e-6)


def test_cases_instants_and_seeds_have_errors_of_their_own():
    case, moment = torch.tensor([[1, 2], [3, 1]]), torch.tensor([[0, 0], [0, 1]])
    errors = case_noise(NoiseSource.EGO, case, moment, (5, 2), seed=0)
    assert errors.shape == (2, 2, 5, 2)
    assert errors.unique().numel() == errors.numel()
    assert torch.equal(case_noise(NoiseSource.EGO, case[0], moment[0], (5, 2), 0), errors[0])
    assert not torch.equal(case_noise(NoiseSource.EGO, case, moment, (5, 2), 1), errors)
    many = case_noise(NoiseSource.EGO, torch.arange(1000), torch.zeros(1000).long(), (4,), 0)
    assert abs(float(many.mean())) < 0.05
    assert float(many.std()) == pytest.approx(1.0, abs=0.05)


def test_sources_with_the_same_seed_have_errors_of_their_own():
    case = torch.arange(2000)
    moment = torch.zeros_like(case)
    errors = torch.cat([case_noise(each, case, moment, (2,), 0) for each in NoiseSource], -1)
    correlation = torch.corrcoef(errors.T) - torch.eye(2 * len(NoiseSource))
    assert float(correlation.abs().max()) < 0.1


def test_no_case_has_no_errors():
    empty = torch.zeros(0, dtype=torch.long)
    assert case_noise(NoiseSource.EGO, empty, empty, (3,), 0).shape == (0, 3)
    assert milliseconds(torch.tensor([0.25, 1.0])).tolist() == [250, 1000]
