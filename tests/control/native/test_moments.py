"""Moments of Gaussian controls from a library, against the first-order rules in tensors."""

import pytest
import torch

from diffstack_mmv.control.native import bending, modules
from diffstack_mmv.control.native.moments import _fit, moments
from diffstack_mmv.dynamics import DiffGM3, DiffKBM, ExtendedUnicycle, SingleIntegrator, rollout
from diffstack_mmv.dynamics.gm3 import PaperBrush
from diffstack_mmv.dynamics.kbm import SoftplusFloor
from diffstack_mmv.prediction.trajectron.jacobians import linearise
from diffstack_mmv.prediction.trajectron.mixture import propagate
from diffstack_mmv.vehicles import load_vehicle

DOUBLE, ROWS, STEPS = torch.float64, 3, 5


def model(kind, learned):
    made = kind(dt_s=0.1) if kind is SingleIntegrator else kind(load_vehicle("bicycle"), 0.1)
    for parameter in made.parameters():
        parameter.requires_grad_(learned)
    return made.to(DOUBLE)


def rows(dynamics):
    """First states, factors of their covariances, controls, and factors of theirs."""
    torch.manual_seed(0)
    n, m = dynamics.state_dim, dynamics.control_dim
    state = 0.2 * torch.randn(ROWS, n, dtype=DOUBLE)
    state[:, 2:4] += 3
    factor = 0.1 * torch.randn(ROWS, n, n, dtype=DOUBLE)
    controls = 0.3 * torch.randn(ROWS, STEPS, m, dtype=DOUBLE)
    scale = 0.2 * torch.randn(ROWS, STEPS, m, m, dtype=DOUBLE).tril()
    return [each.requires_grad_() for each in (state, factor, controls, scale)]


def by_tensors(dynamics, state, factor, controls, scale):
    """Mean and covariance of the first two states, one row and step at a time."""
    means, covariances = rollout(dynamics, state, controls), []
    for row in range(ROWS):
        covariance = factor[row] @ factor[row].mT
        for step in range(STEPS):
            point = means[row, step], controls[row, step]
            a, b = torch.autograd.functional.jacobian(dynamics, point, create_graph=True)
            driven = b @ scale[row, step]
            covariance = a @ covariance @ a.mT + driven @ driven.mT
            covariances.append(covariance[:2, :2])
    return means[:, 1:, :2], torch.stack(covariances).unflatten(0, (ROWS, STEPS))


def by_library(dynamics, state, factor, controls, scale):
    return moments(dynamics, state, factor @ factor.mT, controls, scale)


@pytest.mark.parametrize("learned", [False, True])
@pytest.mark.parametrize(
    "kind",
    [
        DiffKBM,
        *(
            pytest.param(kind, marks=pytest.mark.slow)
            for kind in (ExtendedUnicycle, SingleIntegrator, DiffGM3)
        ),
    ],
)
def test_moments_and_gradients_are_those_of_tensors(kind, learned):
    dynamics = model(kind, learned)
    inputs = rows(dynamics)
    sources = inputs + [each for each in dynamics.parameters() if each.requires_grad]
    found = []
    for form in (by_tensors, by_library):
        results = form(dynamics, *inputs)
        toward = [torch.cos(result.detach() + 1) for result in results]
        slopes = torch.autograd.grad(
            results, sources, toward, allow_unused=True, materialize_grads=True
        )
        found.append([*results, *slopes])
    for expected, other in zip(*found, strict=True):
        torch.testing.assert_close(other, expected, rtol=1e-10, atol=1e-12)


def braked_into_a_turn(dynamics, dtype):
    """Moments by library and by tensors of a vehicle that brakes hard at 8 m/s and turns."""
    n, m = dynamics.state_dim, dynamics.control_dim
    state, eye = torch.zeros(1, n, dtype=dtype), torch.eye(n, dtype=dtype)
    state[:, dynamics.State._fields.index(SPEED[type(dynamics)])] = 8
    controls = torch.tensor([-3.6, -0.09], dtype=dtype).expand(1, 12, m).contiguous()
    scale = (0.1 * torch.eye(m, dtype=dtype)).expand(1, 12, m, m).contiguous()
    found = moments(dynamics, state, 0.01 * eye.unsqueeze(0), controls, scale)
    states = rollout(dynamics, state, controls)
    linear = linearise(dynamics, states[:, :-1], controls)
    expected = propagate(linear, 0.1 * eye.unsqueeze(0), scale)[..., :2, :2]
    return found, (states[:, 1:, :2], expected)


SPEED = {DiffGM3: "velocity_forward", DiffKBM: "speed"}


@pytest.mark.parametrize(
    ("make", "calm"),
    [
        (lambda vehicle: DiffKBM(vehicle, 0.1, floor=SoftplusFloor()), 12),
        pytest.param(
            lambda vehicle: DiffGM3(vehicle, 0.1, tire=PaperBrush()), 7, marks=pytest.mark.slow
        ),
    ],
)
def test_moments_are_finite_where_an_exponential_of_the_model_overflows(make, calm):
    """After `calm` steps the covariance grows by orders, and with it the rounding of each way."""
    dynamics = make(load_vehicle("bicycle"))
    single = braked_into_a_turn(dynamics.float(), torch.float32)
    double = braked_into_a_turn(dynamics.double(), torch.float64)
    torch.testing.assert_close(*double, rtol=1e-9, atol=1e-9)
    for by_library, by_tensors, exact in zip(*single, double[1], strict=True):
        before = slice(calm)
        torch.testing.assert_close(
            by_library[:, before], by_tensors[:, before], rtol=1e-3, atol=1e-3
        )
        rounding = relative_error(by_tensors, exact)
        assert relative_error(by_library, exact) < 1e-3 + 2 * rounding
        assert rounding < 3e-2


def relative_error(found, exact):
    return ((found - exact).abs() / (1 + exact.abs())).max()


def test_changed_numbers_of_a_model_reach_its_library():
    dynamics = model(DiffKBM, True)
    inputs = rows(dynamics)
    before = by_library(dynamics, *inputs)[0]
    with torch.no_grad():
        next(dynamics.parameters()).add_(0.3)
    after = by_library(dynamics, *inputs)[0]
    assert not torch.equal(before, after)
    torch.testing.assert_close(after, rollout(dynamics, *inputs[::2])[:, 1:, :2])


def test_functions_that_are_built_side_by_side_are_those_of_one_library(monkeypatch):
    found = []
    for limit in (modules.LONG_SOURCE, 0):
        monkeypatch.setattr(modules, "LONG_SOURCE", limit)
        dynamics = model(DiffKBM, True)
        inputs = rows(dynamics)
        results = by_library(dynamics, *inputs)
        sources = inputs + [each for each in dynamics.parameters() if each.requires_grad]
        total = sum(result.sin().sum() for result in results)
        found.append([*results, *torch.autograd.grad(total, sources, materialize_grads=True)])
    for alone, apart in zip(*found, strict=True):
        torch.testing.assert_close(alone, apart, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("reason", ["no compiler", "no scalar form"])
def test_without_a_library_there_are_no_moments(monkeypatch, reason):
    def refuse(*_):
        raise modules.CannotBuildError(reason)

    class Sorted(torch.nn.Module):
        def forward(self, state, control):
            return state.sort(-1).values + control.sum(-1, keepdim=True)

    dynamics = model(DiffKBM, False)
    if reason == "no compiler":
        monkeypatch.setattr(modules, "load", refuse)
        assert by_library(dynamics, *rows(dynamics)) is None
    else:
        step = Sorted()
        step.register_buffer("unused", torch.zeros(1, dtype=DOUBLE))
        assert by_library(step, *rows(dynamics)) is None


def test_rows_without_a_gradient_are_left_out():
    """Also where they are no whole packs of eight."""
    dynamics, count = model(DiffKBM, True), 19
    inputs = [each.detach().repeat(7, *[1] * (each.dim() - 1))[:count] for each in rows(dynamics)]
    inputs = [each + 0.01 * torch.randn_like(each) for each in inputs]
    live = torch.arange(count) % 5 != 3
    found = []
    for chosen in (torch.ones(count, dtype=torch.bool), live):
        given = [each[chosen].requires_grad_() for each in inputs]
        results = by_library(dynamics, *given)
        counts = live[chosen].double()
        whole = sum((counts * result.sin().flatten(1).sum(-1)).sum() for result in results)
        parameters = [each for each in dynamics.parameters() if each.requires_grad]
        found.append(torch.autograd.grad(whole, [*given, *parameters]))
    everybody, alone = found
    for slope, other in zip(everybody[:4], alone[:4], strict=True):
        assert (slope[~live] == 0).all()
        torch.testing.assert_close(slope[live], other, rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(everybody[4:], alone[4:], rtol=1e-10, atol=1e-12)


def test_steps_too_long_to_be_written_out_go_row_by_row(monkeypatch):
    """As those of DiffGM3, whose library takes the compiler too long for a short test."""
    results = []
    for longest in (bending.LONGEST_GRADIENT, 0):
        monkeypatch.setattr(bending, "LONGEST_GRADIENT", longest)
        dynamics = model(DiffKBM, True)
        inputs = rows(dynamics)
        found = by_library(dynamics, *inputs)
        toward = [torch.cos(each.detach()) for each in found]
        parameters = [each for each in dynamics.parameters() if each.requires_grad]
        results.append([*found, *torch.autograd.grad(found, [*inputs, *parameters], toward)])
    torch.testing.assert_close(*results, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("short", range(4))
def test_rows_that_do_not_fit_together_are_left_to_tensors(short):
    """The library would read beyond those of which there is only one, and floats as doubles."""
    given = [each.detach() for each in rows(model(SingleIntegrator, False))]
    assert _fit(*given)
    for other in (given[short][:1], given[short].float(), given[short].unsqueeze(0)):
        assert not _fit(*given[:short], other, *given[short + 1 :])


def test_rows_that_a_model_does_not_take_are_left_to_tensors_after_those_that_it_does():
    """The library of those was called with others: doubles were read as floats."""
    dynamics = model(SingleIntegrator, False)
    given = [each.detach() for each in rows(dynamics)]
    assert moments(dynamics, *given) is not None
    assert moments(dynamics, *(each.float() for each in given)) is None
    fewer = given[0][:, :3], given[1][:, :3, :3], given[2], given[3]
    assert moments(dynamics, *fewer) is None
    assert moments(dynamics, *given) is not None


class OneState(torch.nn.Module):
    """A model without a position in two coordinates."""

    def __init__(self):
        super().__init__()
        self.gain = torch.nn.Parameter(torch.ones(1, dtype=DOUBLE))

    def forward(self, state, control):
        return state + self.gain * control


def test_a_model_without_two_states_has_no_moments():
    shapes = (3, 1), (3, 1, 1), (3, 4, 1), (3, 4, 1, 1)
    assert moments(OneState(), *(torch.ones(shape, dtype=DOUBLE) for shape in shapes)) is None
