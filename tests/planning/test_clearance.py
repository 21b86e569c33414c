"""Clearance of plans, and what is asked of it."""

import pytest
import torch
from diffstack_mmv.simulation.safety import clearance_of

from diffstack_mmv.simulation import SafetyMargin


def crossing(offset):
    """A plan along x and a human along y that meet between two samples, `offset` m apart."""
    plan = torch.tensor([[[[-1.5, 0.0], [1.5, 0.0]]]])
    human = torch.tensor([[[[offset, -1.0], [offset, 1.0]]]])
    return plan, human


def test_clearance_sees_what_happens_between_the_samples():
    plan, human = crossing(0.0)
    assert float(clearance_of(plan, human, torch.tensor([[0.6]]))) == pytest.approx(-0.6, abs=1e-6)


def test_clearance_equals_a_fine_search():
    plan, human = torch.randn(2, 3, 5, 2), torch.randn(2, 4, 5, 2)
    share = torch.linspace(0, 1, 2001)[:, None]
    fine = [
        torch.lerp(path[..., :-1, None, :], path[..., 1:, None, :], share) for path in (plan, human)
    ]
    distance = (fine[1].unsqueeze(1) - fine[0].unsqueeze(2)).norm(dim=-1).amin(-1)
    found = clearance_of(plan, human, torch.full((2, 4), 0.6))
    assert torch.allclose(found, distance - 0.6, atol=2e-3)


def judged(clearance, walked, **settings):
    shape = (1, 1, 1, 4)
    margin = SafetyMargin(**settings)
    return margin(torch.full(shape, clearance), torch.full(shape, walked), 0.25)


def test_a_walker_needs_more_room_than_somebody_at_rest():
    assert bool(judged(0.12, 0.0, hard_m=0.1, hard_growth=0.05).safe)
    assert not bool(judged(0.12, 1.0, hard_m=0.1, hard_growth=0.05).safe)


def test_comfort_is_priced_and_not_required():
    judgement = judged(0.2, 0.0, hard_m=0.1, comfort_m=0.35)
    assert bool(judgement.safe)
    assert float(judgement.penalty) == pytest.approx(0.15**2, rel=1e-5)


def test_refusal_looks_no_further_than_its_horizon():
    clearance = torch.tensor([1.0, 1.0, 1.0, -1.0]).reshape(1, 1, 1, 4)
    near = SafetyMargin(horizon_s=0.75)(clearance, torch.zeros(1, 1, 1, 4), 0.25)
    far = SafetyMargin(horizon_s=1.0)(clearance, torch.zeros(1, 1, 1, 4), 0.25)
    assert bool(near.safe)
    assert not bool(far.safe)


def test_an_early_lack_of_clearance_weighs_more():
    early = torch.tensor([-0.1, 1.0]).reshape(1, 1, 1, 2)
    margin, still = SafetyMargin(), torch.zeros(1, 1, 1, 2)
    assert margin(early, still, 0.5).shortfall > margin(early.flip(-1), still, 0.5).shortfall


@pytest.mark.parametrize("name", ["hard_m", "comfort_growth", "saturation_m", "horizon_s"])
def test_numbers_out_of_range_are_refused(name):
    with pytest.raises(ValueError, match=name):
        SafetyMargin(**{name: -1.0})
