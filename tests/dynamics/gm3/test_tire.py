"""Tyre laws against reference vectors, their limits, and their derivatives."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from diffstack_mmv.dynamics.gm3.tire import ConsistentBrush, PaperBrush, SharpBrush

FORCES = ("Fx", "Fy", "Mz")
INPUTS = ("Fz", "sigma_x", "sigma_y", "alpha", "phi", "mu", "cp", "l")
BICYCLE = {"friction": 0.8, "tread_stiffness": 1.5e6, "contact_half_length": 0.045}


def error(law, tires, prefix, dtype, row=None):
    """Largest error relative to the larger of the value and the friction limit."""
    found = law(*(tires[key].to(dtype) for key in INPUTS))
    limit = tires["mu"] * tires["Fz"]
    errors = []
    for name, value in zip(FORCES, found, strict=True):
        expected = tires[f"{prefix}_{name}"] if row is None else tires[f"{prefix}_{name}"][row]
        scale = limit * tires["l"] if name == "Mz" else limit
        errors.append((value.double() - expected).abs() / torch.maximum(expected.abs(), scale))
    return torch.stack(errors).max().item()


@pytest.mark.parametrize(("dtype", "limit"), [(torch.float64, 1e-9), (torch.float32, 1e-4)])
@pytest.mark.parametrize(
    ("law", "prefix"), [(ConsistentBrush(), "consistent"), (SharpBrush(), "gm3")]
)
def test_law_matches_the_reference(law, prefix, dtype, limit, tires):
    assert error(law, tires, prefix, dtype) < limit


@pytest.mark.parametrize(("dtype", "limit"), [(torch.float64, 1e-9), (torch.float32, 1e-4)])
@pytest.mark.parametrize("row", range(4))
def test_printed_smooth_law_matches_the_reference(row, dtype, limit, tires):
    law = PaperBrush(float(tires["k"][row]), float(tires["eps"]))
    assert error(law, tires, "diffgm3", dtype, row) < limit


def bicycle_forces(law, slip_x, slip_y, load=500.0, spin=0.0):
    values = [torch.as_tensor(value).double() for value in (load, slip_x, slip_y)]
    load, slip_x, slip_y = torch.broadcast_tensors(*values)
    angle, spin = torch.atan(slip_y), torch.full_like(load, spin)
    parameters = {key: torch.tensor(value).double() for key, value in BICYCLE.items()}
    return law(load, slip_x, slip_y, angle, spin, **parameters)


@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(0, 2000), st.floats(-20, 20))
def test_consistent_force_never_leaves_the_friction_circle(slip_x, slip_y, load, spin):
    force_x, force_y, _ = bicycle_forces(ConsistentBrush(), slip_x, slip_y, load, spin)
    assert torch.hypot(force_x, force_y) <= 0.8 * load * (1 + 1e-9) + 1e-4


@pytest.mark.parametrize("law", [ConsistentBrush(), PaperBrush(), SharpBrush()])
def test_the_road_does_not_pull(law):
    pulled, none = (bicycle_forces(law, 0.02, 0.1, load) for load in (-500.0, 0.0))
    assert pulled == none
    assert abs(none.force_y) < 0.1  # N, of 242 N with that load


@pytest.mark.parametrize("law", [PaperBrush(), SharpBrush()])
def test_printed_laws_leave_the_friction_circle_in_combined_slip(law):
    force_x, force_y, _ = bicycle_forces(law, 1.0, 1.0)
    assert torch.hypot(force_x, force_y) > 1.2 * 0.8 * 500


def test_small_slip_gives_the_cornering_stiffness():
    _, force_y, moment_z = bicycle_forces(ConsistentBrush(), 0.0, 1e-7)
    stiffness = 2 * 1.5e6 * 0.045**2
    assert force_y / 1e-7 == pytest.approx(stiffness, rel=1e-5)
    assert moment_z / 1e-7 == pytest.approx(-stiffness * 0.045 / 3, rel=1e-5)


def test_camber_thrust_survives_only_in_the_consistent_law():
    thrust = 2 / 3 * 1.5e6 * 0.045**3 * 0.1
    _, kept, _ = bicycle_forces(ConsistentBrush(), 0.0, 0.0, spin=0.1)
    _, dropped, _ = bicycle_forces(PaperBrush(), 0.0, 0.0, spin=0.1)
    assert kept == pytest.approx(thrust, rel=2e-2)
    assert dropped == 0.0


def test_smooth_error_falls_with_the_cube_of_the_steepness_in_pure_slip():
    slip = torch.linspace(0.05, 0.6, 2001).double()
    exact, _, _ = bicycle_forces(ConsistentBrush(), slip, 0.0)
    errors = [
        (bicycle_forces(PaperBrush(k, 1e-16), slip, 0.0)[0] - exact).abs().max().item()
        for k in (100.0, 200.0, 400.0)
    ]
    assert errors[0] / errors[1] == pytest.approx(8, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(8, rel=0.05)


EDGES = [(0.0, 0.0), (0.1, -0.05), (0.0, 0.3), (0.9, 0.0), (-3.0, 5.0), (1e-9, -1e-9)]


@pytest.mark.parametrize(
    "law", [ConsistentBrush(), PaperBrush()], ids=lambda law: type(law).__name__
)
@pytest.mark.parametrize(("slip_x", "slip_y"), EDGES)
def test_gradient_is_exact(law, slip_x, slip_y):
    values = [slip_x, slip_y, 0.2, 0.8, 1.5e6, 0.045]
    inputs = [torch.tensor(value).double().requires_grad_() for value in values]

    def function(slip_x, slip_y, spin, friction, stiffness, length):
        load = torch.tensor(500.0).double()
        angle = torch.atan(slip_y)
        return law(load, slip_x, slip_y, angle, spin, friction, stiffness, length)

    torch.autograd.gradcheck(function, inputs, eps=1e-8, rtol=2e-3, atol=1e-2)


@pytest.mark.parametrize(
    "law", [ConsistentBrush(), PaperBrush()], ids=lambda law: type(law).__name__
)
@pytest.mark.parametrize("load", [0.0, 1e-12, 1e-3])
def test_unloaded_wheel_has_finite_derivatives(law, load):
    weight = torch.tensor(load).double().requires_grad_()
    slip = torch.tensor(0.2).double().requires_grad_()
    forces = bicycle_forces_at(law, weight, slip)
    first = torch.autograd.grad(sum(forces), (weight, slip), create_graph=True)
    second = torch.autograd.grad(sum(first), (weight, slip))
    assert all(torch.isfinite(value) for value in (*forces, *first, *second))


def bicycle_forces_at(law, load, slip):
    parameters = {key: torch.tensor(value).double() for key, value in BICYCLE.items()}
    return law(load, slip, slip, torch.atan(slip), torch.zeros_like(slip), **parameters)


@pytest.mark.parametrize(
    ("build", "told"),
    [
        (lambda: ConsistentBrush(0.0), "epsilon"),
        (lambda: PaperBrush(steepness=-1.0), "steepness"),
        (lambda: PaperBrush(epsilon=0.0), "epsilon"),
    ],
)
def test_impossible_width_is_refused(build, told):
    with pytest.raises(ValueError, match=f"`{told}` must be positive"):
        build()


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("place", range(8))
def test_a_number_in_the_place_of_a_tensor_is_refused(place):
    given = [torch.tensor(number) for number in (400.0, 0.1, 0.1, 0.1, 0.0, 0.8, 1.5e6, 0.045)]
    given[place] = given[place].item()
    with pytest.raises(TypeError, match=r"must be a tensor, but got float. Write torch.as_tensor"):
        ConsistentBrush()(*given)
