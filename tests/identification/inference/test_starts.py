"""Where the search for other optima begins, and how it ends early."""

import logging

import pytest
import torch

from diffstack_mmv.dynamics.manoeuvres import Slalom
from diffstack_mmv.identification import Identifier, MultipleShooting
from diffstack_mmv.identification.inference.starts import (
    MOST_GROWTH,
    calm_starts,
    error_growth,
    sobol_starts,
)
from diffstack_mmv.identification.shooting.fit import total_cost
from tests.identification.conftest import double_precision, synthetic_problem

FAST = (Slalom(8.0, 0.05, 1.5, 2),)
TYRES = ["contact_half_length", "tread_stiffness"]


@pytest.fixture(scope="module")
def fast():
    """A quick ride of a bicycle whose tyres are not known."""
    with double_precision():
        return synthetic_problem("gm3", {}, manoeuvres=FAST, parameters=TYRES)


@pytest.fixture(scope="module")
def spinning(fast):
    """Tyres that are a seventh as stiff behind as in front: a critical speed below the ride's."""
    parameters = fast.simulator.parameters
    values = parameters.prior.mean.clone()
    for name, factor in (("front", 1.5), ("rear", 0.6)):
        values[parameters.names.index(f"contact_half_length.{name}")] *= factor
    return parameters.theta_for(values)


def test_starts_lie_inside_the_ranges_and_differ(fast):
    parameters = fast.simulator.parameters
    values = parameters.values(sobol_starts(parameters, 8))
    assert bool(((values > parameters.prior.low) & (values < parameters.prior.high)).all())
    assert len(values.unique(dim=0)) == 8


def test_errors_grow_where_the_vehicle_spins(fast, spinning):
    simulator, problem = fast.simulator, fast.data.fitted
    calm = error_growth(simulator, simulator.parameters.start(), problem)
    assert error_growth(simulator, spinning, problem) > MOST_GROWTH * calm


def test_no_search_begins_where_the_vehicle_spins(fast, spinning, monkeypatch, caplog):
    simulator, problem = fast.simulator, fast.data.fitted
    theta = simulator.parameters.start()
    drawn = torch.stack([spinning, 0.1 + theta, 0.2 + theta])
    monkeypatch.setattr(
        "diffstack_mmv.identification.inference.starts.sobol_starts", lambda *_: drawn
    )
    active = torch.ones_like(theta, dtype=torch.bool)
    with caplog.at_level(logging.INFO):
        found = calm_starts(simulator, problem, theta, active, 2)
    torch.testing.assert_close(torch.stack(found), drawn[1:])
    assert "1 starts at which the vehicle spins were passed over" in caplog.text


def test_values_that_are_not_fitted_stay_where_they_are(fast):
    theta = fast.simulator.parameters.start() + 0.1
    active = torch.zeros_like(theta, dtype=torch.bool)
    (found,) = calm_starts(fast.simulator, fast.data.fitted, theta, active, 1)
    torch.testing.assert_close(found, theta)


def test_start_that_stays_above_a_cost_is_given_up(fast, monkeypatch):
    """Before, such a start wandered through all its iterations, and then again."""
    monkeypatch.setattr("diffstack_mmv.identification.shooting.multiple_shooting.PATIENCE", 1)
    simulator, data = fast.simulator, fast.data
    theta = simulator.parameters.start()
    prior = Identifier()._tracked(simulator, data, theta, None)
    active = torch.ones_like(theta, dtype=torch.bool)
    found = MultipleShooting(tolerance=1e-300).searching(1e-9)(simulator, data, prior, active)
    assert len(found.history) == 2
    assert total_cost(simulator, found) > 1e-9
