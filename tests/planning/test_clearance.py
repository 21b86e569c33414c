"""Clearance of plans, and what is asked of it."""

import math
from dataclasses import fields

import pytest
import torch

from diffstack_mmv.planning import ClearanceMargin, clearance_within_steps
from diffstack_mmv.types import Discs, Motion, Obstacles, map_tensors


def moving(position):
    """Motions through these points, heading east."""
    zero = torch.zeros_like(position[..., 0])
    return Motion(position, zero, torch.zeros_like(position), zero)


def agents(position, weight=None, radius=0.3):
    """Agents *b N K T1 with equally likely components unless told otherwise."""
    components = position.shape[-3]
    if weight is None:
        weight = torch.full(position.shape[:-2], 1 / components)
    size = torch.full(position.shape[:-3], radius)
    return Obstacles(position, weight, size, torch.ones_like(size, dtype=torch.bool))


def discs(*ahead, batch=1, radius=0.3):
    places = torch.tensor(ahead).expand(batch, len(ahead))
    return Discs(places, torch.full_like(places, radius))


def crossing(offset):
    """A plan along x and an agent along y that meet between two samples, `offset` m apart."""
    plan = torch.tensor([[[[-1.5, 0.0], [1.5, 0.0]]]])
    agent = torch.tensor([[[[[offset, -1.0], [offset, 1.0]]]]])
    return moving(plan), agents(agent)


def test_clearance_sees_what_happens_between_the_samples():
    plan, agent = crossing(0.0)
    found = clearance_within_steps(plan, discs(0.0), agent)
    assert float(found) == pytest.approx(-0.6, abs=1e-6)


@pytest.mark.parametrize("ahead", [(0.0,), (0.5, -0.5)])
def test_clearance_equals_a_fine_search_over_all_discs(ahead):
    plan, agent = torch.randn(2, 3, 5, 2), torch.randn(2, 4, 2, 5, 2)
    share = torch.linspace(0, 1, 2001)[:, None]

    def fine(path):
        return torch.lerp(path[..., :-1, None, :], path[..., 1:, None, :], share)

    each = [
        fine(agent)[:, None] - fine(plan + torch.tensor([a, 0.0]))[:, :, None, None] for a in ahead
    ]
    distance = torch.stack([offset.norm(dim=-1).amin(-1) for offset in each]).amin(0)
    found = clearance_within_steps(moving(plan), discs(*ahead, batch=2), agents(agent))
    assert found.shape == (2, 3, 4, 2, 4)
    assert torch.allclose(found, distance - 0.6, atol=2e-3)


def test_who_is_not_valid_is_infinitely_far_away():
    plan, agent = crossing(0.0)
    gone = agent._replace(valid=torch.zeros_like(agent.valid))
    assert clearance_within_steps(plan, discs(0.0), gone).isinf().all()


def walking(metres, steps=4, components=1):
    """An agent that walks so far within the first step."""
    path = torch.zeros(1, 1, components, steps + 1, 2)
    path[..., 1:, 0] = metres
    return agents(path)


def judged(clearance, walked, **settings):
    near = torch.full((1, 1, 1, 1, 4), clearance)
    return ClearanceMargin(**settings)(near, walking(walked), 0.25)


@pytest.mark.parametrize("number", range(3))
def test_each_problem_of_a_batch_is_judged_among_its_own_agents(number):
    def alone(record):
        return map_tensors(lambda entry: entry[number, None], record)

    margin, clearance = ClearanceMargin(turn_rate=0.3), 0.3 * torch.randn(3, 4, 2, 2, 4)
    around = agents(0.2 * torch.randn(3, 2, 2, 5, 2).cumsum(-2))
    for judge in (margin, margin.risk):
        expected = judge(alone(clearance), alone(around), 0.25)
        torch.testing.assert_close(alone(judge(clearance, around, 0.25)), expected)


@pytest.mark.parametrize(("walked", "safe"), [(0.0, True), (1.0, False)])
def test_a_pedestrian_who_walks_needs_more_room_than_one_at_rest(walked, safe):
    assert bool(judged(0.12, walked, hard_m=0.1, hard_growth=0.05).safe) is safe


def test_comfort_is_priced_and_not_required():
    judgement = judged(0.2, 0.0, hard_m=0.1, comfort_m=0.35)
    assert bool(judgement.safe)
    assert float(judgement.penalty) == pytest.approx(0.15**2, rel=1e-5)


@pytest.mark.parametrize(("walked", "lack"), [(0.0, 0.0), (1.0, 0.05), (5.0, 0.1)])
def test_comfort_is_asked_of_more_room_the_further_somebody_has_walked_up_to_a_limit(walked, lack):
    judgement = judged(0.3, walked, comfort_m=0.25, comfort_growth=0.1, saturation_m=1.5)
    assert float(judgement.penalty) == pytest.approx(lack**2, rel=1e-4)


@pytest.mark.parametrize(("horizon_s", "safe"), [(0.75, True), (1.0, False)])
def test_refusal_looks_no_further_than_its_horizon(horizon_s, safe):
    clearance = torch.tensor([1.0, 1.0, 1.0, -1.0]).reshape(1, 1, 1, 1, 4)
    margin = ClearanceMargin(horizon_s=horizon_s)
    assert bool(margin(clearance, walking(0.0), 0.25).safe) is safe


def test_an_early_lack_of_clearance_weighs_more():
    early = torch.tensor([-0.1, 1.0]).reshape(1, 1, 1, 1, 2)
    margin, still = ClearanceMargin(), walking(0.0, steps=2)
    assert margin(early, still, 0.5).shortfall > margin(early.flip(-1), still, 0.5).shortfall


@pytest.mark.parametrize(("probability", "safe"), [(0.5, False), (0.06, False), (0.01, True)])
def test_every_likely_component_refuses_and_all_count_as_expected(probability, safe):
    """One component stays far away, the other is hit."""
    clearance = torch.tensor([9.0, -0.1]).reshape(1, 1, 1, 2, 1)
    weight = torch.tensor([[[1 - probability, probability]]])
    two = walking(0.0, steps=1, components=2)._replace(weight=weight)
    judgement = ClearanceMargin(comfort_m=0.4)(clearance, two, 0.25)
    assert bool(judgement.safe) is safe
    assert float(judgement.penalty) == pytest.approx(probability * 0.5**2 * 0.25, rel=1e-5)


def test_nobody_around_is_safe():
    nobody = agents(torch.zeros(1, 0, 1, 5, 2))
    plan = moving(torch.randn(1, 3, 5, 2))
    safety = ClearanceMargin()(clearance_within_steps(plan, discs(0.0), nobody), nobody, 0.25)
    assert safety.safe.all()
    assert (safety.penalty == 0).all()
    assert (safety.shortfall == 0).all()


@pytest.mark.parametrize("name", [field.name for field in fields(ClearanceMargin)])
def test_numbers_out_of_range_are_refused(name):
    with pytest.raises(ValueError, match=name):
        ClearanceMargin(**{name: -1.0})


def test_the_risk_of_a_sure_overlap_is_its_time():
    clearance = torch.tensor([1.0, 1.0, -0.1, -0.2]).reshape(1, 1, 1, 1, 4)
    assert float(ClearanceMargin().risk(clearance, walking(0.0), 0.25)) == pytest.approx(0.5, 0.01)


def test_who_has_walked_far_is_a_smaller_risk_where_expected_and_a_larger_one_beside():
    def risk(clearance, walked):
        near = torch.full((1, 1, 1, 1, 4), clearance)
        return float(ClearanceMargin().risk(near, walking(walked), 0.25))

    assert risk(-0.1, 4.0) < 0.7 * risk(-0.1, 0.5)
    assert risk(0.8, 4.0) > 2 * risk(0.8, 0.5)


def test_absent_agents_are_no_risk():
    nowhere = torch.full((1, 1, 1, 1, 4), torch.inf)
    assert float(ClearanceMargin().risk(nowhere, walking(1.0), 0.25)) == 0


@pytest.mark.parametrize("gap", [0.0, 0.3])
@pytest.mark.parametrize("walked", [0.5, 1.0, 3.0])
def test_a_vague_forecast_meets_whom_it_expects_as_often_as_its_spread_leaves(walked, gap):
    margin = ClearanceMargin(spread_growth=0.25, reach_m=0.6)
    agent = agents(torch.tensor([[[[[0.0, 0.0], [walked, 0.0]]]]]))
    found = margin.risk(torch.full((1, 1, 1, 1, 1), gap), agent, 0.25)
    spread = 2 * (0.25 * walked) ** 2
    expected = 0.25 * 0.36 / (0.36 + spread) * math.exp(-(gap**2) / spread)
    assert float(found) == pytest.approx(expected, rel=1e-5)


def test_who_may_turn_off_is_a_risk_of_both_spreads():
    turning = ClearanceMargin(spread_growth=0.25, turn_rate=0.2, turn_growth=0.8)
    near = torch.full((1, 1, 1, 1, 4), 0.7)

    def risk(spread):
        return ClearanceMargin(spread_growth=spread).risk(near, walking(1.0), 0.25)

    found = turning.risk(near, walking(1.0), 0.25)
    assert risk(0.25) < found < risk(0.8)
    never = ClearanceMargin(spread_growth=0.25, turn_rate=1e-9)
    torch.testing.assert_close(never.risk(near, walking(1.0), 0.25), risk(0.25))
    at_once = ClearanceMargin(spread_growth=0.25, turn_rate=1e3, turn_growth=0.8)
    torch.testing.assert_close(at_once.risk(near, walking(1.0), 0.25), risk(0.8))


def test_who_may_turn_off_has_done_so_with_the_chance_of_the_time_gone():
    margin = ClearanceMargin(spread_growth=0.0, turn_rate=0.4, turn_growth=0.5, reach_m=0.6)
    agent = agents(torch.tensor([[[[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]]]]))
    far = torch.tensor([torch.inf, 1.0]).reshape(1, 1, 1, 1, 2)
    expected = (1 - math.exp(-0.4 * 0.5)) * 0.36 / (0.36 + 2) * math.exp(-0.5) * 0.25
    assert float(margin.risk(far, agent, 0.25)) == pytest.approx(expected, rel=1e-5)
