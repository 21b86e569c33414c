"""Plans are judged in a library as on tensors."""

import pytest
import torch

from diffstack_mmv.planning import ClearanceMargin, clearance_within_steps
from diffstack_mmv.planning.judgement import judged, library
from diffstack_mmv.types import Discs, Motion, Obstacles, map_tensors

STEPS = 6


def plans(dtype, count):
    position = 0.5 * torch.randn(3, count, STEPS + 1, 2, dtype=dtype).cumsum(-2)
    flat = torch.zeros_like(position[..., 0])
    return Motion(position, torch.randn_like(flat), torch.zeros_like(position), flat)


def people(dtype, components):
    walk = 0.3 * torch.randn(3, 4, components, STEPS + 1, 2, dtype=dtype).cumsum(-2)
    start = torch.randn(3, 4, 1, 1, 2, dtype=dtype)
    weight = torch.rand(3, 4, components, dtype=dtype) * 0.1
    weight[:, 0, 0] = 0.0
    radius = 0.2 + 0.2 * torch.rand(3, 4, dtype=dtype)
    return Obstacles(start + walk, weight, radius, torch.rand(3, 4) < 0.7)


@pytest.mark.skipif(library() is None, reason="there is no compiler")
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("ahead", "components", "count"), [((0.0,), 1, 5), ((-0.5, 0.7), 3, 37)])
@pytest.mark.parametrize("turn_rate", [0.0, 0.5])
def test_the_library_judges_as_the_tensors(dtype, ahead, components, count, turn_rate):
    motion, agents = plans(dtype, count), people(dtype, components)
    places = torch.tensor(ahead, dtype=dtype).expand(3, -1)
    discs = Discs(places, torch.full_like(places, 0.3))
    margin = ClearanceMargin(horizon_s=1.0, hard_growth=0.1, turn_rate=turn_rate)
    under_way = torch.arange(STEPS + 1) <= torch.randint(1, STEPS + 2, (3, count, 1))
    clearance = clearance_within_steps(motion, discs, agents)
    clearance = torch.where(under_way[..., None, None, :-1], clearance, torch.inf)
    safety, risk = margin(clearance, agents, 0.25), margin.risk(clearance, agents, 0.25)
    found = judged(margin, motion, discs, agents, under_way, 0.25)
    assert found is not None
    near = 1e-5 if dtype == torch.float32 else 1e-12
    assert torch.equal(found.safety.safe, safety.safe)
    for one, other in ((found.safety.penalty, safety.penalty), (found.risk, risk)):
        assert torch.allclose(one, other, rtol=near, atol=near)
    assert torch.allclose(found.safety.shortfall, safety.shortfall, atol=near)
    assert not safety.safe.all()
    assert risk.max() > 0.01


def test_other_shapes_are_left_to_the_tensors():
    given = plans(torch.float32, 2), people(torch.float32, 1)
    motion, agents = map_tensors(lambda entry: entry[0], given)
    discs, here = Discs(torch.zeros(1), torch.ones(1)), torch.ones(2, STEPS + 1, dtype=torch.bool)
    assert judged(ClearanceMargin(), motion, discs, agents, here, 0.25) is None
