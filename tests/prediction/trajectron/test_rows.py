"""The predictor with a row for every agent equals the one with rows of those who are present."""

import pytest
import torch

from diffstack_mmv.prediction.trajectron import agent_batch, interaction, rows
from diffstack_mmv.prediction.trajectron.rows import chosen
from diffstack_mmv.types import Motion
from tests.prediction.samples import bicycle, scene, trajectron

MODULES = agent_batch, interaction, rows


@pytest.fixture
def masked(monkeypatch):
    """As on a device whose answers the host would have to wait for."""

    def begin():
        for module in MODULES:
            monkeypatch.setattr(module, "on_host", lambda _: False)

    return begin


def crowd(neighbors):
    """Scenes with agents near each other: one without an ego, others with gaps and absent people.

    Whoever is absent is not a number.
    """
    batch = scene(batch=(4,), neighbors=neighbors, dtype=torch.float64)

    def without(tracks, valid):
        def unknown(field):
            mask = valid.reshape(*valid.shape, *(1,) * (field.dim() - valid.dim()))
            return torch.where(mask, field, torch.nan)

        return tracks._replace(motion=Motion(*map(unknown, tracks.motion)), valid=valid)

    ego, others = batch.ego_past.valid.clone(), batch.neighbors_past.valid.clone()
    ego[1, -1] = False
    ego[2, 5:9] = False
    if neighbors > 1:
        others[0, 0], others[2, 1, -1], others[3, :, :-3] = False, False, False
        others[1, :] = False
    return batch._replace(
        ego_past=without(batch.ego_past, ego),
        neighbors_past=without(batch.neighbors_past, others),
    )


def judged(model, batch):
    model.zero_grad()
    model.training_step.zero_()
    forecast, loss = model.predict_and_judge(batch)
    (loss.sum() + forecast.mean.square().sum()).backward()
    slopes = {name: p.grad.clone() for name, p in model.named_parameters() if p.grad is not None}
    return [*forecast, loss], slopes


@pytest.mark.parametrize("neighbors", [0, 4])
@pytest.mark.parametrize("neighbor_components", [0, 3])
@pytest.mark.parametrize("rough", [False, True])
def test_forecast_loss_and_gradient_are_the_same(masked, neighbors, neighbor_components, rough):
    model = trajectron(
        bicycle(kinematic=True), neighbor_components=neighbor_components, rough=rough
    ).double()
    batch = crowd(neighbors)
    gathered, slopes = judged(model, batch)
    masked()
    found, others = judged(model, batch)
    for first, second in zip(gathered, found, strict=True):
        assert torch.allclose(first, second, rtol=1e-9, atol=1e-9)
    for name, slope in others.items():
        expected = slopes.get(name, torch.zeros_like(slope))
        assert torch.allclose(slope, expected, rtol=1e-7, atol=1e-9), name


def test_scenes_without_anybody_have_a_loss_of_zero(masked):
    masked()
    batch = crowd(2)
    nobody = torch.zeros_like(batch.ego_past.valid)
    batch = batch._replace(ego_past=batch.ego_past._replace(valid=nobody))
    model = trajectron().double()
    loss = model.loss(batch)
    loss.sum().backward()
    assert torch.isfinite(loss).all()
    assert all(p.grad is None or torch.isfinite(p.grad).all() for p in model.parameters())


@pytest.mark.parametrize("mask", [[], [False] * 3, [True, False, True]])
def test_only_rows_of_the_mask_are_replaced(masked, mask):
    wanted = torch.tensor(mask, dtype=torch.bool)
    into = torch.zeros(len(mask), 2)

    def replaced():
        picked = chosen(wanted)
        return picked.put(into, torch.ones(len(picked.index), 2))

    expected = wanted[:, None].expand(-1, 2).float()
    assert torch.equal(replaced(), expected)
    masked()
    assert torch.equal(replaced(), expected)


def test_pairs_with_a_row_for_every_agent_are_those_of_present_ones(masked):
    index = torch.arange(12)
    before = [interaction.neighboring_rows(index, 4, ego_only) for ego_only in (False, True)]
    masked()
    after = [interaction.neighboring_rows(index, 4, ego_only) for ego_only in (False, True)]
    for first, second in zip(before, after, strict=True):
        assert pairs_of(first) == pairs_of(second)


def pairs_of(rows_of_pairs):
    return set(zip(*(each.tolist() for each in rows_of_pairs), strict=True))
