"""When held-out tracks end a fit."""

import pytest
import torch

from diffstack_mmv.identification import HeldoutStopping, ParameterFit
from diffstack_mmv.identification.shooting.fit import HeldoutMonitor
from diffstack_mmv.identification.shooting.tracking import TrackingSolution
from tests.identification.conftest import LAZY, double_precision, synthetic_problem


@pytest.fixture(scope="module")
def blank():
    with double_precision():
        setup = synthetic_problem("kbm", {}, manoeuvres=LAZY[:1])
        problem, theta = setup.data.heldout, setup.simulator.parameters.start()
        simulated = setup.simulator.simulate(theta, problem, problem.guess)
        tracked = TrackingSolution(problem.guess, simulated, torch.ones(1, dtype=torch.bool))
    return ParameterFit(theta, tracked, tracked, ())


def with_costs(blank, costs):
    simulated = blank.heldout.simulated._replace(cost=torch.tensor(costs))
    return blank._replace(heldout=blank.heldout._replace(simulated=simulated))


@pytest.mark.parametrize(
    ("costs", "patience", "goes_on"),
    [
        ([[cost] * 9 for cost in (3.0, 2.0, 2.5, 2.6, 2.7)], 3, [True] * 4 + [False]),
        ([[3.0, 3.0, 3.0], [2.0, 3.5, 4.5]], 1, [True, True]),
    ],
    ids=["all get worse", "they disagree"],
)
def test_a_fit_ends_at_the_last_iterate_before_all_held_out_tracks_get_worse(
    blank, costs, patience, goes_on
):
    fits = [with_costs(blank, each) for each in costs]
    monitor = HeldoutMonitor(HeldoutStopping(patience=patience), fits[0])
    assert [monitor.observe(fit, 0.0) for fit in fits] == goes_on
    assert monitor.best is fits[1]


@pytest.mark.parametrize(
    ("own", "goes_on", "best"),
    [
        ((10.0, 9e5, 8e4, 7e3, 60.0, 5.0), [True] * 6, 5),
        ((10.0, 9.0, 8.0, 7.0, 6.0, 5.0), [True] * 3 + [False], 0),
    ],
    ids=["while gaps close", "learned by heart"],
)
def test_worse_on_held_out_tracks_counts_only_where_the_fitted_ones_are_explained_better(
    blank, own, goes_on, best
):
    fits = [with_costs(blank, [cost] * 9) for cost in (3.0, 5.0, 6.0, 7.0, 8.0, 2.0)]
    monitor = HeldoutMonitor(HeldoutStopping(patience=3), fits[0])
    taken = list(zip(fits, own, strict=True))[: len(goes_on)]
    assert [monitor.observe(fit, cost) for fit, cost in taken] == goes_on
    assert monitor.best is fits[best]
