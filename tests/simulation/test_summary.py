"""The numbers of a benchmark, from episodes made by hand."""

import numpy as np
import pytest
import torch

from diffstack_mmv.simulation import summarise
from diffstack_mmv.simulation.chunks import Chunk
from diffstack_mmv.types import EpisodeRecord, Motion, Outcome


def chunk_of(cases, steps, outcomes, step_s, clearance, **diagnosis):
    """Episodes at rest, half a metre from the nearest pedestrian but for `clearance`."""
    count, rows = len(cases), max(steps)
    flat = torch.zeros(count, rows + 1, dtype=torch.float64)
    pair = flat[..., None].expand(count, rows + 1, 2)
    near = torch.full_like(flat, 0.5)
    for (episode, row), value in clearance.items():
        near[episode, row] = value
    record = EpisodeRecord(
        motion=Motion(pair, flat, pair, flat),
        pedestrians=pair[:, :, None],
        controls=pair[:, 1:],
        reward=flat[:, 1:],
        clearance=near,
        outcome=torch.tensor([int(outcome) for outcome in outcomes]),
        steps=torch.tensor(steps),
        duration=0.25 * torch.tensor(steps, dtype=torch.float64),
        dt_s=0.25,
    )
    told = {name: np.array(values) for name, values in diagnosis.items()}
    return Chunk(list(cases), record, np.array(step_s), told, {}, {})


@pytest.fixture
def told():
    first = chunk_of(
        (7, 8), (2, 4), (Outcome.COLLISION, Outcome.SUCCESS), (0.1, 0.1, 0.3, 0.5),
        {(0, 2): -0.1, (1, 1): 0.1, (1, 3): 0.15}, solved_share=[0.5, 1.0],
    )  # fmt: skip
    second = chunk_of((9,), (1,), (Outcome.COLLISION,), (0.05,), {(0, 0): torch.inf})
    return summarise([first, second])


def test_a_benchmark_keeps_up_by_the_time_driven_over_the_time_decided(told):
    decided = 2 * 0.1 + 2 * 0.1 + 1 * 0.3 + 1 * 0.5 + 1 * 0.05
    assert told["real_time_factor"] == pytest.approx(0.25 * (2 + 4 + 1) / decided)


def test_times_of_decisions_are_the_median_and_the_worst_percent_in_milliseconds(told):
    assert told["control_time_ms"]["median"] == pytest.approx(100.0)
    assert told["control_time_ms"]["p99"] == pytest.approx(300 + 0.96 * 200)


def test_solved_plans_count_by_the_steps_of_the_cases_that_tell_of_them(told):
    assert told["solved_share"] == pytest.approx((2 * 0.5 + 4 * 1.0) / 6)
    nobody_solves = chunk_of((1,), (2,), (Outcome.SUCCESS,), (0.1, 0.1), {})
    assert summarise([nobody_solves])["solved_share"] is None


def test_scores_and_cases_are_those_of_all_chunks(told):
    assert told["n"] == 3
    assert told["success_rate"] == pytest.approx(1 / 3)
    assert told["nav_time_s"] == pytest.approx(1.0)
    low, high = told["collision_rate_ci95"]
    assert told["collision_rate"] == pytest.approx(2 / 3)
    assert low < told["collision_rate"] < high
    kept = ("case", "outcome", "time_s", "steps", "min_clearance_m", "discomfort_steps")
    assert [tuple(case[name] for name in kept) for case in told["cases"]] == [
        (7, "collision", 0.5, 2, -0.1, 0),
        (8, "success", 1.0, 4, 0.1, 2),
        (9, "collision", 0.25, 1, 0.5, 0),
    ]


def test_a_score_without_a_case_that_counts_is_none():
    alone = chunk_of((1,), (2,), (Outcome.COLLISION,), (0.1, 0.1), dict.fromkeys(
        [(0, 0), (0, 1), (0, 2)], torch.inf
    ))  # fmt: skip
    found = summarise([alone])
    assert (found["nav_time_s"], found["avg_min_dist_m"]) == (None, None)
    assert found["cases"][0]["min_clearance_m"] is None
