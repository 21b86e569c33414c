"""Estimates of the present motion, and the start of each component that is made of them."""

import pytest
import torch

from diffstack_mmv.prediction.current import Trend, current_course
from diffstack_mmv.prediction.trajectron.start import (
    ESTIMATES,
    START_FEATURES,
    StartBlend,
    estimates,
    start_features,
)
from tests.prediction.samples import DT_S, scene, trajectron

REST = ESTIMATES - 1


def riders(velocity, noise_m=0.0, count=3, rows=41):
    """Straight tracks of constant velocity in m/s, with noise on each position."""
    tracks = scene(batch=(count,), neighbors=0, history=rows, dtype=torch.float64).ego_past
    time = DT_S * torch.arange(1 - rows, 1, dtype=torch.float64).unsqueeze(-1)
    way = (time * torch.tensor(velocity, dtype=torch.float64)).expand(count, -1, -1)
    noise = torch.randn(way.shape, generator=torch.Generator().manual_seed(0), dtype=way.dtype)
    motion = tracks.motion._replace(position=5.0 + way + noise_m * noise)
    return tracks._replace(motion=motion, valid=torch.ones_like(tracks.valid))


def test_all_estimates_but_rest_agree_on_a_straight_way():
    found = estimates(riders((3.0, 1.0)), DT_S)
    expected = torch.tensor([3.0, 1.0], dtype=torch.float64)
    # the pull to the measured velocity counts most where the memory is short
    assert torch.allclose(found.velocity[:, :REST], expected.expand(3, REST, 2), atol=0.1)
    assert found.offset[:, :REST].abs().max() < 0.02
    assert found.acceleration.abs().max() < 0.3
    assert found.velocity[:, REST].abs().max() == 0


def test_rest_is_where_a_noisy_track_stands():
    tracks = riders((0.0, 0.0), noise_m=0.1, count=200)
    found = estimates(tracks, DT_S)
    place = found.offset + tracks.motion.position[:, -1:]
    error = (place - 5.0).norm(dim=-1).mean(0)
    assert error[REST] < 0.5 * error[0]


def test_an_agent_that_is_not_observed_has_no_motion():
    tracks = riders((3.0, 1.0))
    found = estimates(tracks._replace(valid=torch.zeros_like(tracks.valid)), DT_S)
    assert max(field.abs().max() for field in found) == 0


@pytest.mark.parametrize("noise_m", [0.0, 0.1])
def test_features_are_of_order_one(noise_m):
    features = start_features(estimates(riders((6.0, 1.0), noise_m), DT_S))
    assert features.shape == (3, START_FEATURES)
    assert 0.05 < features.abs().mean() < 3.0
    assert features.abs().max() < 10.0


@pytest.mark.parametrize("chosen", range(ESTIMATES))
def test_gains_lead_from_the_first_estimate_to_any_other(chosen):
    blend = StartBlend(context_size=4, components=2).double()
    starts = estimates(riders((1.0, 0.5), noise_m=0.1), DT_S)
    if chosen > 0:
        with torch.no_grad():
            blend.gains.bias[chosen - 1] = 20.0  # of the first component
    made = blend(torch.zeros(3, 4, dtype=torch.float64), starts)
    for field, estimate in zip(made, starts, strict=True):
        assert torch.allclose(field[:, 0], estimate[:, chosen])
        assert torch.allclose(field[:, 1], estimate[:, 0])


def test_a_component_that_starts_at_rest_stays_there():
    model = trajectron().double()
    decoder = model.branches[0].decoder
    with torch.no_grad():
        decoder.start.gains.bias[REST - 1 :: ESTIMATES - 1] = 20.0
        decoder.mean_head.weight.zero_()
        decoder.mean_head.bias.zero_()
    tracks = riders((0.0, 0.0), noise_m=0.1)
    nobody = scene(batch=(3,), neighbors=0, history=41, dtype=torch.float64).neighbors_past
    path = model(tracks, nobody).mean[:, 0]
    start = tracks.motion.position[:, -1] + estimates(tracks, DT_S).offset[:, REST]
    assert torch.allclose(path, start[:, None, None].expand_as(path), atol=0.02)


def test_the_course_of_who_rolls_backwards_slowly_has_a_finite_gradient():
    heading = torch.zeros(4, dtype=torch.float64)
    speeds = torch.tensor([-0.24 + 0.01 * step for step in range(3)] + [0.0])
    velocity = torch.stack([speeds.double(), torch.zeros(4, dtype=torch.float64)], -1)
    velocity.requires_grad_()
    current_course(velocity, heading).sum().backward()
    assert velocity.grad.isfinite().all()
    assert velocity.grad.norm(dim=-1).max() < 1 / 0.05


def test_gradients_of_the_blend():
    torch.manual_seed(0)
    blend = StartBlend(context_size=3, components=2).double()
    context = torch.randn(2, 3, dtype=torch.float64, requires_grad=True)
    torch.nn.init.normal_(blend.gains.weight)
    fields = [torch.randn(2, ESTIMATES, 2, dtype=torch.float64) for _ in range(3)]
    assert torch.autograd.gradcheck(lambda c: tuple(blend(c, Trend(*fields))), context)
