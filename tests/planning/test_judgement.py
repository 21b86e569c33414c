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
    driven = torch.arange(STEPS) <= torch.randint(0, STEPS + 1, (3, count, 1))
    clearance = clearance_within_steps(motion, discs, agents)
    clearance = torch.where(driven[..., None, None, :], clearance, torch.inf)
    safety, risk = margin(clearance, agents, 0.25), margin.risk(clearance, agents, 0.25)
    found = judged(margin, motion, discs, agents, driven, 0.25)
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
    discs, here = Discs(torch.zeros(1), torch.ones(1)), torch.ones(2, STEPS, dtype=torch.bool)
    assert judged(ClearanceMargin(), motion, discs, agents, here, 0.25) is None


def judged_among(motion, agents, discs, here):
    return judged(ClearanceMargin(), motion, discs, agents, here, 0.25)


@pytest.mark.skipif(library() is None, reason="there is no compiler")
def test_sizes_that_do_not_fit_together_are_left_to_the_tensors():
    motion, agents = plans(torch.float32, 5), people(torch.float32, 2)
    places, here = torch.zeros(3, 2), torch.ones(3, 5, STEPS, dtype=torch.bool)
    discs = Discs(places, torch.full_like(places, 0.3))
    assert judged_among(motion, agents, discs, here) is not None
    for other in (
        (motion, agents._replace(position=agents.position[..., :2, :]), discs, here),
        (motion, agents._replace(weight=agents.weight[..., :1]), discs, here),
        (motion, agents._replace(radius=agents.radius[:, :1]), discs, here),
        (motion, agents._replace(valid=agents.valid[:, :1]), discs, here),
        (motion._replace(heading=motion.heading[:, :1]), agents, discs, here),
        (motion, agents, discs._replace(radius=discs.radius[:, :1]), here),
        (motion, agents, discs, here[..., :1]),
    ):
        assert judged_among(*other) is None


def in_precision(dtype, *records):
    def moved(entry):
        return entry.to(dtype) if entry.is_floating_point() else entry

    return [map_tensors(moved, record) for record in records]


@pytest.mark.skipif(library() is None, reason="there is no compiler")
def test_numbers_of_unlike_or_low_precision_are_left_to_the_tensors():
    """The library would read them as others than they are."""
    motion, agents = plans(torch.float32, 5), people(torch.float32, 2)
    here = torch.ones(3, 5, STEPS, dtype=torch.bool)
    given = [motion, agents, Discs(torch.zeros(3, 2), torch.full((3, 2), 0.3))]
    for number in range(3):
        unlike = given.copy()
        unlike[number : number + 1] = in_precision(torch.float64, given[number])
        assert judged_among(*unlike, here) is None
    assert judged_among(*in_precision(torch.float64, *given), here) is not None
    assert judged_among(*in_precision(torch.bfloat16, *given), here) is None


@pytest.mark.skipif(library() is None, reason="there is no compiler")
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("unknown", [(2, 0), (2, 1)], ids=["first disc", "last disc"])
def test_what_is_no_number_is_not_safe_in_the_library_either(dtype, unknown):
    """It was: a clearance is the smallest one found, and nothing is smaller than what is none."""
    motion, agents = plans(dtype, 2), people(dtype, 1)
    agents = agents._replace(
        position=agents.position + 100,
        valid=torch.ones_like(agents.valid),
        weight=agents.weight + 1,
    )
    motion.position[0, 0, 2], agents.position[1, 1, 0, 3] = torch.nan, torch.nan
    discs = Discs(torch.zeros(3, 2, dtype=dtype), torch.full((3, 2), 0.3, dtype=dtype))
    discs.radius[unknown] = torch.nan
    here = torch.ones(3, 2, STEPS, dtype=torch.bool)
    expected = ClearanceMargin()(clearance_within_steps(motion, discs, agents), agents, 0.25)
    found = judged_among(motion, agents, discs, here)
    assert torch.equal(found.safety.safe, expected.safe)
    assert found.safety.safe.tolist() == [[False, True], [False, False], [False, False]]
    assert torch.equal(found.safety.penalty.isnan(), expected.penalty.isnan())
