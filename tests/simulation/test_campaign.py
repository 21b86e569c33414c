"""What a campaign refuses, and the time that a decision takes."""

from types import SimpleNamespace

import pytest
import torch

from diffstack_mmv.simulation import Campaign, Method, StraightLine, benchmark
from diffstack_mmv.simulation.benchmark import Timed


@pytest.mark.usefixtures("unchecked")  # no controller and no observation
@pytest.mark.parametrize(("running", "shared"), [([True, False, True, True], 3), ([False], 1)])
def test_the_time_of_a_decision_is_shared_by_the_episodes_that_run(monkeypatch, running, shared):
    clock = iter([7.0, 8.5])
    monkeypatch.setattr(benchmark.time, "process_time", lambda: next(clock))
    timed = Timed(SimpleNamespace(act=lambda state, seen: "decided"))
    assert timed.act(None, SimpleNamespace(running=torch.tensor(running))) == "decided"
    assert timed.seconds == pytest.approx([1.5 / shared])


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("cases", "size", "told"),
    [
        ([0, 4, 0, 5, 4], 3, "`cases` must name each case once, but got '?0, 4 more than once"),
        ([0, 1], 0, "`chunk_size` must be at least 1"),
        ([0, 1], 1.5, "`chunk_size` must be a whole number"),
    ],
)
def test_cases_named_twice_and_chunks_without_a_size_are_refused(
    world_with, scenario_of, tmp_path, cases, size, told
):
    method = Method("straight", world_with(), lambda: StraightLine(2.5))
    with pytest.raises(ValueError, match=told):
        Campaign(method, scenario_of("circle"), cases, tmp_path, size)
