"""Information about values: from equations, into words and verdicts."""

from types import SimpleNamespace

import pytest
import torch

from diffstack_mmv.identification import Identifiability, IdentifiabilityThresholds
from diffstack_mmv.identification.inference.sensitivity import (
    InformationDirection,
    Sensitivity,
    describe_direction,
    owed_to_priors,
    sensitivity,
)
from diffstack_mmv.identification.shooting.block_arrowhead import BlockArrowhead


@pytest.mark.parametrize(
    ("ratio", "precision", "noise_factor", "owed", "expected"),
    [
        (0.1, 0.01, 1.0, 0.2, Identifiability.IDENTIFIABLE),
        (0.1, 0.05, 1.0, 0.2, Identifiability.WEAK),
        (0.9, 0.01, 1.0, 0.2, Identifiability.NOT_IDENTIFIABLE),
        (0.1, 0.01, 1.5, 0.2, Identifiability.WEAK),
        (0.1, 0.01, 1.0, 0.8, Identifiability.COMBINED),
        (0.4, 0.015, 1.25, 0.5, Identifiability.IDENTIFIABLE),
    ],
    ids=[
        "precise",
        "not precise",
        "as wide as the prior",
        "tracks not explained",
        "by priors",
        "bounds",
    ],
)
def test_identifiability_needs_a_ratio_a_precision_a_fit_and_tracks(
    ratio, precision, noise_factor, owed, expected
):
    assert IdentifiabilityThresholds().classify(ratio, precision, noise_factor, owed) is expected


@pytest.mark.usefixtures("unchecked")  # numbers in place of the parameters of a model
def test_information_is_what_is_left_when_the_unknowns_of_the_tracks_are_eliminated():
    std, slope = torch.tensor([0.5, 2.0]), torch.tensor([1.5, 0.4])
    rows = torch.randn(9, 5)
    hessian = rows.mT @ rows + torch.diag(torch.tensor([1.0, 1.0, 1.0, 0.0, 0.0]))
    system = BlockArrowhead(
        hessian[None, :3, :3], hessian[None, :3, 3:], hessian[3:, 3:], rows[:1, :3], rows[0, 3:]
    )
    parameters = SimpleNamespace(prior=SimpleNamespace(std=std), slope=lambda _: slope)
    found = sensitivity(system, parameters, torch.zeros(2), noise_factor=2.0)
    # of the values v, dv = slope dθ; the inverse of the whole marginalises the tracks
    information = torch.linalg.inv(torch.linalg.inv(hessian)[3:, 3:])
    information = information / (slope * slope[:, None]) / 2.0**2
    torch.testing.assert_close(found.information, information)
    posterior = information + (1 / std.square()).diag()
    torch.testing.assert_close(found.covariance, torch.linalg.inv(posterior))
    of_noise = found.covariance @ information @ found.covariance
    torch.testing.assert_close(found.of_noise, of_noise)
    torch.testing.assert_close(found.marginal_ratio, found.covariance.diagonal().sqrt() / std)
    torch.testing.assert_close(found.conditional_ratio, 1 / posterior.diagonal().sqrt() / std)
    in_deviations = information * std * std[:, None]
    for direction in found.directions:
        weights = torch.tensor(direction.weights)
        torch.testing.assert_close(in_deviations @ weights, direction.eigenvalue * weights)
    assert found.directions[0].eigenvalue > found.directions[1].eigenvalue > 0
    assert found.noise_factor == 2.0


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"identifiable": 1.1}, r"`identifiable` must lie in \[0.0, 1.0\], but got 1.1"),
        ({"identifiable": -0.1}, "`identifiable` must lie in"),
        ({"informed": 0.3}, r"`informed` must lie in \[0.4, 1.0\], but got 0.3"),
        ({"informed": 1.2}, "`informed` must lie in"),
        ({"precise": 0.0}, "`precise` must be positive"),
        ({"owed": 1.5}, r"`owed` must lie in \[0.0, 1.0\], but got 1.5"),
        ({"misfit": 0.9}, "`misfit` must be at least 1"),
    ],
)
def test_thresholds_that_are_no_shares_are_refused(given, told):
    with pytest.raises(ValueError, match=told):
        IdentifiabilityThresholds(**given)


def test_share_of_priors_of_what_no_parameter_moves_is_all():
    nothing = torch.zeros(1)
    assert float(owed_to_priors(nothing, nothing)) == 1.0


def test_direction_is_told_by_its_largest_parts():
    told = describe_direction(
        InformationDirection(1.0, (-0.9, 0.05, 0.4)), ["mass", "drag", "friction"]
    )
    assert told == "+0.90 mass, -0.40 friction"
    small = InformationDirection(1.0, (0.09, -0.5, 0.11))  # a fifth of the largest is told
    assert describe_direction(small, ["mass", "drag", "friction"]) == "+0.50 drag, -0.11 friction"


def sensitivity_of(variance, of_noise, prior, conditional=(0.1, 0.1)):
    """Two values, uncorrelated, with these variances, and standard deviations of their priors."""
    variance, std = torch.tensor(variance), torch.tensor(variance).sqrt()
    ratio = std / torch.tensor(prior)
    parts = (variance.diag(), torch.tensor(of_noise).diag(), std, ratio)
    return Sensitivity(torch.eye(2), *parts, torch.tensor(conditional), (), 1.0)


def test_what_widens_a_deviation_counts_as_noise_and_ends_at_the_prior():
    given = sensitivity_of([4.0, 9.0], [3.0, 5.0], [10.0, 4.0])
    found = given.widened(torch.tensor([6.0, 7.0]))
    torch.testing.assert_close(found.std, torch.tensor([6.0, 4.0]))
    torch.testing.assert_close(found.marginal_ratio, torch.tensor([0.6, 1.0]))
    torch.testing.assert_close(found.covariance, torch.tensor([36.0, 16.0]).diag())
    # priors caused 1 of 4 and 4 of 9, and still do
    torch.testing.assert_close(found.of_noise, torch.tensor([35.0, 12.0]).diag())
    assert torch.equal(given.widened(torch.tensor([1.0, 2.0])).std, given.std)


@pytest.mark.parametrize(
    ("conditional", "expected"),
    [
        (0.3, Identifiability.COMBINED),
        (0.4, Identifiability.COMBINED),
        (0.5, Identifiability.WEAK),
        (0.8, Identifiability.WEAK),
        (0.9, Identifiability.NOT_IDENTIFIABLE),
    ],
)
def test_what_is_as_wide_as_its_prior_is_judged_by_what_the_others_would_tell(
    conditional, expected
):
    found = sensitivity_of([0.81, 0.01], [0.81, 0.01], [1.0, 1.0], (conditional, 0.1))
    verdicts = found.classify(torch.tensor([1.0, -20.0]), IdentifiabilityThresholds())
    assert verdicts == [expected, Identifiability.IDENTIFIABLE]
