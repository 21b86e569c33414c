"""Profiles: which values are tried, from where, and what they cost."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from diffstack_mmv.identification import profile_likelihoods
from diffstack_mmv.identification.shooting.fit import ParameterFit
from diffstack_mmv.identification.shooting.tracking import TrackingSolution
from tests.identification.conftest import LIVELY, synthetic_problem

NAMES = ("tread_stiffness", "yaw_inertia")


class StandStill:
    """Fits nothing, and remembers where it was asked to."""

    def __init__(self):
        self.asked, self.active, self.stopped = [], [], True

    def unstopped(self):
        self.stopped = False
        return self

    def __call__(self, simulator, data, before, active):
        assert not self.stopped
        self.asked.append(simulator.parameters.values(before.theta))
        self.active.append(active.tolist())
        return before


def start(setup, away):
    """Tracks as they were recorded, and θ this far from the start."""
    problem, parameters = setup.data.fitted, setup.simulator.parameters
    theta = parameters.start() + away
    simulated = setup.simulator.simulate(theta, problem, problem.guess)
    solution = TrackingSolution(problem.guess, simulated, torch.ones(1) > 0)
    return ParameterFit(theta, solution, solution, ())


def grid_of(parameters, index, points):
    """From 2 % of the range to 98 % of it, evenly."""
    low, high = float(parameters.prior.low[index]), float(parameters.prior.high[index])
    return np.linspace(low + 0.02 * (high - low), high - 0.02 * (high - low), points)


@pytest.mark.usefixtures("unchecked")  # what was identified is no more than a fit
@pytest.mark.parametrize("away", [0.0, 0.3, -0.4])
def test_a_profile_goes_outwards_from_the_estimate_over_nearly_all_of_the_range(away):
    setup = synthetic_problem("gm3", {}, manoeuvres=LIVELY[:1], parameters=NAMES)
    parameters, fit = setup.simulator.parameters, start(setup, away)
    index = parameters.names.index("yaw_inertia")
    method = StandStill()
    shown = profile_likelihoods(
        setup.simulator, setup.data, SimpleNamespace(after=fit), method, ["yaw_inertia"], 5
    )
    grid = grid_of(parameters, index, 5)
    assert list(shown) == ["yaw_inertia"]
    assert shown["yaw_inertia"].values == pytest.approx(tuple(grid))
    estimate = parameters.values(fit.theta)
    above = [value for value in grid if value >= float(estimate[index]) - 1e-12]
    expected = above + [value for value in reversed(grid) if value not in above]
    assert [float(values[index]) for values in method.asked] == pytest.approx(expected)
    others = torch.arange(len(parameters)) != index
    assert method.active == [others.tolist()] * 5
    for values in method.asked:
        torch.testing.assert_close(values[others], estimate[others])


@pytest.mark.usefixtures("unchecked")
def test_a_profile_costs_what_the_tracks_and_the_priors_of_the_others_cost():
    setup = synthetic_problem("gm3", {}, manoeuvres=LIVELY[:1], parameters=NAMES)
    parameters, problem = setup.simulator.parameters, setup.data.fitted
    fit = start(setup, 0.4)
    found = SimpleNamespace(after=fit)
    shown = profile_likelihoods(setup.simulator, setup.data, found, StandStill(), NAMES[1:], 3)
    prior, values = parameters.prior, parameters.values(fit.theta)
    index = parameters.names.index(NAMES[1])
    expected = []
    for value in grid_of(parameters, index, 3):
        there = values.clone()
        there[index] = float(value)
        tracks = setup.simulator.simulate(parameters.theta_for(there), problem, problem.guess)
        of_others = ((there - prior.mean) / prior.std).square()
        of_others[index] = 0.0
        expected.append(float(tracks.cost.detach().sum() + 0.5 * of_others.sum()))
    assert shown[NAMES[1]].costs == pytest.approx(tuple(expected))
    assert len({round(cost, 6) for cost in expected}) == 3
