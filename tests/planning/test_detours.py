"""The fan of detours."""

import pytest
import torch

from diffstack_mmv.simulation import DetourFan, controller_model
from diffstack_mmv.types import Motion, Obstacles, PlanningProblem


def problem(speed=2.0, goal=(5.0, 0.0)):
    motion = Motion(torch.zeros(1, 2), torch.zeros(1), torch.tensor([[speed, 0.0]]), torch.zeros(1))
    nobody = Obstacles(
        torch.zeros(1, 0, 1, 13, 2), torch.ones(1, 0, 1), torch.ones(1, 0), torch.ones(1, 0) > 0
    )
    target = torch.tensor([goal])
    reference = torch.zeros(1, 13, 2)
    return PlanningProblem(
        motion, target, reference, torch.tensor([3.0]), torch.tensor([0.3]), nobody
    )


@pytest.fixture(params=["kbm", "gm3"])
def fan(request, driven):
    vehicle = driven(dynamics=request.param)
    model = controller_model(vehicle, vehicle)
    with torch.no_grad():
        return DetourFan()(model, problem(), 12), model


def test_all_controls_are_admissible(fan):
    candidates, model = fan
    assert torch.equal(model.within_bounds(candidates.controls), candidates.controls)


def test_the_last_candidate_brakes_to_a_stop(fan):
    candidates, _ = fan
    assert float(candidates.motion.velocity[0, -1, -1, 0].abs()) < 0.05
    assert float(candidates.motion.position[0, -1, -1, 0]) < 1.2


def test_one_candidate_arrives(fan):
    candidates, _ = fan
    distance = (candidates.motion.position - torch.tensor([5.0, 0.0])).norm(dim=-1)
    assert float(distance.min()) < 0.25


def test_courses_are_mirrored(fan):
    candidates, _ = fan
    lateral = candidates.motion.position[0, :-1, 5, 1].reshape(9, -1)
    assert torch.allclose(lateral, -lateral.flip(0), atol=1e-3)


@pytest.mark.parametrize("dynamics", ["kbm", "gm3"])
def test_a_goal_beside_a_fast_vehicle_is_not_circled(dynamics, driven):
    vehicle = driven(dynamics=dynamics)
    model = controller_model(vehicle, vehicle)
    with torch.no_grad():
        fan = DetourFan()(model, problem(speed=2.9, goal=(0.5, 2.0)), 20)
    distance = (fan.motion.position - torch.tensor([0.5, 2.0])).norm(dim=-1)
    assert float(distance.min()) < 0.3


@pytest.mark.parametrize(
    ("name", "value"), [("offsets_deg", ()), ("speed_shares", (1.5,)), ("turn_time_s", 0.0)]
)
def test_numbers_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        DetourFan(**{name: value})
