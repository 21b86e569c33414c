"""Deviations from how much tracks contradict each other."""

import numpy as np
import pytest
import torch

from diffstack_mmv.identification import Identifier
from diffstack_mmv.identification.inference.clusters import cluster_std, track_scores
from diffstack_mmv.identification.inference.optima import analyse_optimum
from diffstack_mmv.identification.shooting.block_arrowhead import eliminate_tracks
from diffstack_mmv.identification.shooting.normal_equations import normal_equations
from tests.identification.conftest import double_precision, synthetic_problem


@pytest.fixture(scope="module")
def known():
    with double_precision():
        setup = synthetic_problem("kbm", {"wheelbase": 1.15})
        return setup, Identifier(starts=0)(setup.simulator, setup.data)


def test_deviation_of_a_mean_is_that_of_its_tracks():
    """For one number that every track measures: the standard error of their mean."""
    errors = torch.tensor([0.3, -0.5, 0.1, 0.4, -0.3])
    std = cluster_std(torch.ones(5, 1, 1), errors.unsqueeze(-1), torch.zeros(1))
    torch.testing.assert_close(std, (errors.std() / 5**0.5).reshape(1))


def test_deviations_of_several_values_are_those_of_the_sandwich():
    rng = np.random.default_rng(0)
    roots, gradient = rng.normal(size=(6, 3, 3)), rng.normal(size=(6, 3))
    information, precision = roots @ roots.transpose(0, 2, 1), np.array([0.5, 2.0, 7.0])
    bread = np.linalg.inv(information.sum(0) + np.diag(precision))
    spread = 6 / 5 * sum(np.outer(each, each) for each in gradient)
    expected = np.sqrt(np.diag(bread @ spread @ bread))
    std = cluster_std(*(torch.tensor(entry) for entry in (information, gradient, precision)))
    np.testing.assert_allclose(std.numpy(), expected)


def test_two_tracks_tell_no_spread():
    std = cluster_std(torch.ones(2, 1, 1), torch.ones(2, 1), torch.ones(1))
    assert float(std) == 0.0


def test_tracks_add_up_to_the_whole(known):
    setup, found = known
    unknowns, simulated, _ = found.after.fitted
    jacobian = setup.simulator.jacobian(found.after.theta, setup.data.fitted, unknowns, simulated)
    system = normal_equations(jacobian, simulated.residual, unknowns)
    information, gradient = track_scores(system, jacobian.shared, simulated.residual.flatten(1))
    whole = eliminate_tracks(system)
    torch.testing.assert_close(information.sum(0), whole.information)
    torch.testing.assert_close(gradient.sum(0), whole.gradient)


def test_tracks_that_contradict_each_other_widen_the_deviation(known, monkeypatch):
    setup, found = known
    best = found.optima[0].sensitivity
    monkeypatch.setattr(
        "diffstack_mmv.identification.inference.optima.cluster_std", lambda *_: 2 * best.std
    )
    wider = analyse_optimum(setup.simulator, setup.data.fitted, found.after).sensitivity
    torch.testing.assert_close(wider.std, 2 * best.std)
    torch.testing.assert_close(wider.covariance.diagonal().sqrt(), wider.std)
    owed = wider.covariance - wider.of_noise
    torch.testing.assert_close(owed, best.covariance - best.of_noise)


def test_no_deviation_exceeds_that_of_the_prior(known):
    setup, found = known
    prior = setup.simulator.parameters.prior.std
    wider = found.sensitivity.widened(100 * prior)
    torch.testing.assert_close(wider.std, prior)
    torch.testing.assert_close(wider.marginal_ratio, torch.ones(1))
