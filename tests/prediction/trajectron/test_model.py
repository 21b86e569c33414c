"""Trajectron++ as a whole."""

import pytest
import torch

from diffstack_mmv.dynamics import SingleIntegrator
from diffstack_mmv.prediction import (
    Annealing,
    ConstantTurnRateAcceleration,
    Trajectron,
    ego_forecast,
    neighbors_forecast,
)
from diffstack_mmv.prediction.trajectron import linearise, linearise_shared
from diffstack_mmv.types import Forecast
from tests.prediction.samples import DT_S, at_rest, bicycle, scene, trajectron


def untrained(ego_dynamics, horizon=10):
    torch.manual_seed(1)
    return Trajectron(
        ego_dynamics,
        bicycle(),
        SingleIntegrator(DT_S),
        horizon_steps=horizon,
        components=4,
        neighbor_components=2,
    ).eval()


@pytest.mark.parametrize("kinematic", [False, True])
def test_untrained_it_is_close_to_the_fading_ctra(kinematic):
    batch = scene(history=41, neighbors=0)
    mean = ego_forecast(untrained(bicycle(kinematic)).predict(batch)).mean
    ctra = ego_forecast(ConstantTurnRateAcceleration(10, DT_S).predict(batch)).mean
    assert (mean - ctra).norm(dim=-1).max() < 0.12


@pytest.mark.parametrize("kinematic", [False, True])
def test_every_parameter_learns_from_a_scene_with_all_kinds(kinematic):
    model = trajectron(bicycle(kinematic), annealing=Annealing(free_nats=0.0))
    batch = scene(batch=(4,), neighbors=4)
    model.loss(batch._replace(neighbors_past=gathered(batch))).sum().backward()
    learning = {name: p for name, p in model.named_parameters() if p.requires_grad}
    silent = [name for name, p in learning.items() if p.grad is None or p.grad.abs().max() == 0]
    assert silent == []


def gathered(batch):
    """The neighbors, moved to within a few metres of the ego."""
    motion = batch.neighbors_past.motion
    centre = batch.ego_past.motion.position[:, -1]
    shift = centre[:, None, None] - motion.position[:, :, -1:]
    offset = 3 * torch.randn(*motion.position.shape[:2], 1, 2)
    return batch.neighbors_past._replace(
        motion=motion._replace(position=motion.position + shift + offset)
    )


@pytest.mark.parametrize("neighbors", [0, 3])
@pytest.mark.parametrize("kinematic", [False, True])
def test_gradients_are_finite_at_rest(kinematic, neighbors):
    model = trajectron(bicycle(kinematic))
    model.loss(at_rest(scene(neighbors=neighbors))).sum().backward()
    assert all(torch.isfinite(p.grad).all() for p in model.parameters() if p.grad is not None)


def test_a_near_neighbor_changes_the_forecast_of_the_ego():
    model, batch = trajectron().eval(), scene(neighbors=2)
    near = batch._replace(neighbors_past=gathered(batch))
    gone = near.neighbors_past._replace(valid=torch.zeros_like(near.neighbors_past.valid))
    with_others, alone = model.predict(near), model.predict(near._replace(neighbors_past=gone))
    assert (ego_forecast(with_others).mean - ego_forecast(alone).mean).abs().max() > 1e-4


def test_components_that_a_neighbor_lacks_have_no_weight():
    forecast = neighbors_forecast(trajectron().eval().predict(scene(neighbors=2)))
    assert (forecast.log_weight[..., :3].exp().sum(-1) - 1).abs().max() < 1e-5
    assert forecast.log_weight[..., 3:].exp().abs().max() == 0


def test_loss_in_float64_equals_the_bound_written_out():
    model = (
        trajectron(annealing=Annealing(weight=7.0, crossover_steps=1, free_nats=0.0))
        .double()
        .eval()
    )
    model.training_step.fill_(100)
    batch = scene(neighbors=0, dtype=torch.float64)
    forecast = ego_forecast(model.predict(batch))
    apart = Forecast(*(field.unsqueeze(2) for field in forecast))._replace(
        log_weight=torch.zeros(3, 4, 1)
    )
    log_prob = apart.log_prob(batch.ego_future.motion.position.unsqueeze(1)).sum(-1)
    with torch.no_grad():
        for layer in model.branches[0].latent.posterior:
            for parameter in layer.parameters():
                parameter.zero_()
    uniform = torch.full((3, 4), 0.25, dtype=torch.float64)
    divergence = (uniform * (uniform.log() - forecast.log_weight)).sum(-1)
    expected = (
        7.0 * divergence - torch.logsumexp(log_prob - torch.tensor(4.0).double().log(), -1)
    ) / 10
    assert torch.allclose(model.loss(batch), expected)


def test_annealing_advances_in_training_only_and_survives_a_checkpoint():
    model, batch = trajectron(), scene()
    model.eval().loss(batch)
    assert model.training_step == 0
    model.train().loss(batch)
    model.loss(batch)
    restored = trajectron()
    restored.load_state_dict(model.state_dict())
    assert restored.training_step == 2


@pytest.mark.parametrize("jacobians", [linearise, linearise_shared])
@pytest.mark.parametrize(("count", "neighbors"), [(0, 0), (0, 2), (1, 0), (2, 1)])
def test_batches_of_any_size_have_a_loss_with_a_gradient(count, neighbors, jacobians):
    model = trajectron(bicycle(kinematic=True), jacobians=jacobians)
    forecast, loss = model.predict_and_judge(scene(batch=(count,), neighbors=neighbors))
    assert forecast.mean.shape[:2] == (count, 1 + neighbors)
    assert loss.shape == (count,)
    if count:
        loss.sum().backward()
        slopes = [p.grad for p in model.parameters() if p.grad is not None]
        assert slopes
        assert all(torch.isfinite(slope).all() for slope in slopes)


@pytest.mark.parametrize("jacobians", [linearise, linearise_shared])
def test_it_learns_under_autocast(jacobians):
    model = trajectron(bicycle(kinematic=True), jacobians=jacobians)
    with torch.autocast("cpu", torch.bfloat16):
        loss = model.loss(scene(neighbors=2))
    loss.sum().backward()
    assert all(torch.isfinite(p.grad).all() for p in model.parameters() if p.grad is not None)


def test_a_component_out_of_question_costs_nothing_backward(monkeypatch):
    model, batch = trajectron().double(), scene(neighbors=0, dtype=torch.float64)
    decoder, seen = model.branches[0].decoder, []
    moments = decoder._moments
    monkeypatch.setattr(
        decoder, "_moments", lambda *rows: seen.append(len(rows[0])) or moments(*rows)
    )
    with torch.no_grad():
        decoder.gate_component[1:, :16] += 40.0
        decoder.start_component[0] -= 40.0
        last = model.branches[0].latent.posterior[-1]
        last.bias[0] += 100.0
        last.bias[1:] -= 100.0
    model.loss(batch).sum().backward()
    assert seen[0] == 12
    assert seen[1] < 12


def test_models_of_different_time_steps_are_refused():
    with pytest.raises(ValueError, match="`dt_s` must be the same for all three dynamics"):
        Trajectron(bicycle(), bicycle(), SingleIntegrator(0.2))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("name", ["components", "neighbor_components", "horizon_steps"])
def test_parts_of_a_component_or_a_step_are_refused(name):
    with pytest.raises(ValueError, match=f"`{name}` must be a whole number, but got 2.5"):
        Trajectron(bicycle(), bicycle(), SingleIntegrator(), **{name: 2.5})


@pytest.mark.slow
@pytest.mark.parametrize("kinematic", [False, True])
def test_it_can_learn_one_batch_by_heart(kinematic):
    batch = scene(batch=(8,), neighbors=1, history=21)
    swerve = 0.01 * torch.arange(1, 11).square().unsqueeze(-1) * torch.randn(8, 1, 2).clamp(-1, 1)
    future = batch.ego_future.motion
    batch = batch._replace(
        ego_future=batch.ego_future._replace(
            motion=future._replace(position=future.position + swerve)
        )
    )
    model = trajectron(bicycle(kinematic))
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-2)
    model.train()
    for _ in range(200):
        optimizer.zero_grad()
        model.loss(batch).mean().backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
    error = (
        ego_forecast(model.eval().predict(batch)).most_likely() - batch.ego_future.motion.position
    )
    assert error.norm(dim=-1).mean() < 0.4 * swerve.norm(dim=-1).mean()


@pytest.mark.parametrize("ask", [Trajectron.predict, Trajectron.loss], ids=["predict", "loss"])
@pytest.mark.parametrize(
    ("own", "given"), [(torch.float64, torch.float32), (torch.float32, torch.float64)]
)
def test_tracks_of_another_precision_are_refused(ask, own, given):
    model = trajectron().to(own)
    with pytest.raises(ValueError, match=f"`past.motion` must be {own} as the predictor, but got"):
        ask(model, scene(dtype=given))
    assert ask(model, scene(dtype=own))[0].dtype == own
