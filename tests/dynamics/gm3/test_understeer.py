"""Quantities by which textbooks tell understeer, and the steering of the linear theory."""

from dataclasses import replace

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3, rollout
from diffstack_mmv.vehicles import load_vehicle
from tests.dynamics.gm3.test_physics import build, moving


@pytest.mark.parametrize(
    ("name", "front", "rear"),
    [
        ("bicycle", 11, 12),
        ("tricycle", 11, 12),
        ("tadpole", 11, 12),
        ("cart", 8, 9),
        ("motorcycle", 14, 15),
        ("scooter", 9, 10),
    ],
)
def test_the_stiffness_of_an_axle_per_load_is_that_of_its_source(
    name: str, front: float, rear: float
) -> None:
    """The files of the vehicles say from which C / F_z their tread stiffness comes."""
    told = build(name).derived_quantities()
    ends = (told[f"normalised_cornering_stiffness.{end}"] for end in ("front", "rear"))
    assert [float(end.value) for end in ends] == pytest.approx([front, rear], rel=1e-3)


@pytest.mark.parametrize(
    ("name", "length"), [("bicycle", 1.0), ("motorcycle", 0.9), ("tricycle", 0.9), ("cart", 1.0)]
)
def test_a_slight_curvature_is_held_to_a_thousandth(name: str, length: float) -> None:
    spec = load_vehicle(name)
    scale = replace(spec.parameters["length_scale"], initial=length, low=0.8, high=1.2)
    spec = replace(spec, parameters={**spec.parameters, "length_scale": scale})
    model = DiffGM3(spec, dt_s=0.25).double().requires_grad_(False)
    curvature = torch.full((3,), 2e-3).double()
    state = torch.cat([moving(model, speed, 2e-3 * speed) for speed in (2.0, 4.0, 7.0)])
    control = model.control_for(state, torch.zeros(3).double(), curvature)
    end = rollout(model, state, control.unsqueeze(1).expand(-1, 15, -1))[:, -1]
    torch.testing.assert_close(end[:, 5] / end[:, 2], curvature, rtol=1e-3, atol=0)
