"""The learnable numbers of a vehicle as one vector."""

from dataclasses import replace

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3, DiffKBM, ExtendedUnicycle
from diffstack_mmv.identification import ParameterVector
from diffstack_mmv.vehicles import load_vehicle


def tied(spec, name):
    parameters = dict(spec.parameters)
    parameters[name] = replace(parameters[name], tied=True)
    return replace(spec, parameters=parameters)


def test_names_tell_the_wheel(bicycle):
    learned = ParameterVector(DiffGM3(bicycle).double(), bicycle)
    assert {"friction.front", "friction.rear", "yaw_inertia"} <= set(learned.names)
    assert ParameterVector(DiffKBM(bicycle).double(), bicycle).names == ["wheelbase"]
    assert len(ParameterVector(ExtendedUnicycle(bicycle).double(), bicycle)) == 0


def test_tied_wheels_share_one_number(bicycle):
    spec = tied(bicycle, "friction")
    names = ParameterVector(DiffGM3(spec).double(), spec).names
    assert "friction" in names
    assert "friction.front" not in names


def test_values_and_theta_are_inverse(bicycle):
    learned = ParameterVector(DiffGM3(bicycle).double(), bicycle)
    values = learned.prior.low + 0.3 * (learned.prior.high - learned.prior.low)
    torch.testing.assert_close(learned.values(learned.theta_for(values)), values)


def test_slope_is_the_derivative(bicycle):
    learned = ParameterVector(DiffGM3(bicycle).double(), bicycle)
    theta = 0.3 * torch.randn(len(learned))
    exact = torch.autograd.functional.jacobian(learned.values, theta).diagonal()
    torch.testing.assert_close(learned.slope(theta), exact)


def test_store_moves_the_model(bicycle):
    model = DiffGM3(bicycle).double()
    learned = ParameterVector(model, bicycle)
    values = learned.prior.mean.clone()
    values[learned.names.index("friction.rear")] = 0.55
    learned.store(learned.theta_for(values))
    torch.testing.assert_close(
        model.physical_parameters()["friction"], torch.tensor([0.8, 0.55]), atol=1e-12, rtol=0.0
    )


def test_steps_keep_inside_of_the_range(bicycle):
    learned = ParameterVector(DiffKBM(bicycle).double(), bicycle)
    room = learned.step_bounds(learned.start())
    ends = learned.prior.mean + learned.prior.std * torch.stack([room.lower, room.upper]).squeeze()
    assert 0.8925 < float(ends[0]) < 0.894
    assert 1.206 < float(ends[1]) < 1.2075


def test_move_goes_straight_along_a_product(bicycle):
    learned = ParameterVector(DiffGM3(bicycle).double(), bicycle)
    stiffness, length = (
        learned.names.index(f"{name}.front") for name in ("tread_stiffness", "contact_half_length")
    )
    start = learned.values(learned.start())
    relative = torch.zeros(len(learned))
    relative[stiffness], relative[length] = 0.6, -0.3
    moved = learned.values(learned.moved(learned.start(), relative * start / learned.prior.std))
    before, after = (each[stiffness] * each[length] ** 2 for each in (start, moved))
    torch.testing.assert_close(after, before)


def test_move_is_the_step_to_first_order_and_ends_at_the_range(bicycle):
    learned = ParameterVector(DiffGM3(bicycle).double(), bicycle)
    theta, step = learned.start(), 1e-4 * torch.ones(len(learned))
    change = learned.values(learned.moved(theta, step)) - learned.values(theta)
    torch.testing.assert_close(change, step * learned.prior.std, rtol=1e-3, atol=0.0)
    room = learned.bounds_of_moves(theta)
    ends = [learned.values(learned.moved(theta, each)) for each in room]
    margin = 0.002 * (learned.prior.high - learned.prior.low)
    assert bool(((ends[0] - learned.prior.low).abs() < margin).all())
    assert bool(((ends[1] - learned.prior.high).abs() < margin).all())


def test_unknown_parameter_is_refused_by_name(bicycle):
    with pytest.raises(ValueError, match="`parameters` must be one of .*friction.*but got 'grip'"):
        ParameterVector(DiffGM3(bicycle).double(), bicycle, ["grip"])


def test_calibrated_values_build_the_calibrated_vehicle():
    spec = load_vehicle("bicycle")
    learned = ParameterVector(DiffGM3(spec).double(), spec)
    values = learned.prior.mean * 1.05
    moved = spec.with_values(learned.calibrated(learned.theta_for(values)), "test")
    again = ParameterVector(DiffGM3(moved).double(), moved)
    torch.testing.assert_close(again.prior.mean, values, rtol=1e-9, atol=0.0)


def test_drawn_values_lie_inside_the_ranges_around_the_means(bicycle):
    prior = ParameterVector(DiffGM3(bicycle).double(), bicycle).prior
    values = prior.draw_values(torch.Generator().manual_seed(0), spread=3.0)
    assert bool(((values > prior.low) & (values < prior.high)).all())
    near = prior.draw_values(torch.Generator().manual_seed(0), spread=0.5)
    assert bool(((near - prior.mean).abs() <= 0.5 * prior.std).all())
