"""Forecasts of pedestrians: exact where the model is, and honest about what they cannot know."""

import pytest
import torch

from diffstack_mmv.simulation import (
    ConstantVelocityForecaster,
    MixedForecaster,
    OrcaCrowd,
    OrcaForecaster,
    StandingForecaster,
)
from diffstack_mmv.types import map_tensors


def paths(forecaster, *observations, dt_s=0.25, steps=4):
    """Likeliest paths after the last observation, row 0 now."""
    state = forecaster.init(observations[0])
    for seen in observations:
        forecast, state = forecaster(state, seen, dt_s, steps)
    return torch.cat((seen.pedestrian_position.unsqueeze(-2), forecast.most_likely()), -2)


@pytest.mark.parametrize(
    ("forecaster", "share"), [(ConstantVelocityForecaster(), 1.0), (StandingForecaster(), 0.0)]
)
def test_who_walks_on_or_stays_keeps_one_velocity(observed, scene_with, forecaster, share):
    seen = observed(scene_with((3.0, 0.0), (-6.0, 0.0)), 2)[-1]
    assert seen.pedestrian_velocity.abs().max() > 0
    path = paths(forecaster, seen)
    moved = 0.25 * share * seen.pedestrian_velocity.unsqueeze(-2)
    assert torch.allclose(path.diff(dim=-2), moved.expand(*path.shape[:-2], 4, 2))


@pytest.mark.parametrize(
    "forecaster", [ConstantVelocityForecaster(), StandingForecaster(), OrcaForecaster()]
)
def test_the_forecast_is_one_proper_component_per_pedestrian(observed, scenario_of, forecaster):
    before, seen = observed(scenario_of("circle").cases("test", [0, 1]), 3)[-2:]
    _, state = forecaster(forecaster.init(before), before, 0.25, 4)
    forecast, _ = forecaster(state, seen, 0.25, 4)
    assert forecast.log_weight.shape == (2, 5, 1)
    assert forecast.mean.shape == (2, 5, 1, 4, 2)
    assert torch.equal(forecast.log_weight.exp().sum(-1), torch.ones(2, 5).double())
    assert (forecast.scale_tril.diagonal(dim1=-2, dim2=-1) > 0).all()
    spread = forecast.scale_tril.diagonal(dim1=-2, dim2=-1).prod(-1)
    assert (spread.diff(dim=-1) > 0).all()


def test_who_rests_at_first_sight_may_walk_off_in_every_direction(observed, scenario_of):
    seen = observed(scenario_of("circle").cases("test", [0, 1]), 1)[0]
    assert (seen.pedestrian_velocity == 0).all()
    forecast, state = OrcaForecaster(directions=8, stays=0.2)(None, seen, 0.25, 4)
    assert forecast.mean.shape == (2, 5, 9, 4, 2)
    assert torch.allclose(forecast.log_weight.exp().sum(-1), torch.ones(2, 5).double())
    assert forecast.log_weight.exp()[..., 0].allclose(torch.tensor(0.2).double())
    gone = (forecast.mean[..., -1, :] - seen.pedestrian_position.unsqueeze(-2)).norm(dim=-1)
    assert gone[..., 0].max() < 1e-6
    assert gone[..., 1:].allclose(torch.tensor(1.0).double())
    middle = forecast.mean[..., 1:, -1, :].mean(-2)
    assert middle.allclose(seen.pedestrian_position, atol=1e-6)


def test_who_walks_at_first_sight_walks_on(observed, scene_with):
    seen = observed(scene_with((3.0, -5.0), (3.0, 5.0)), 3)[-1]
    forecast, _ = OrcaForecaster()(None, seen, 0.25, 4)
    assert (forecast.mean == forecast.mean[..., :1, :, :]).all()


def test_a_lone_pedestrian_is_predicted_exactly_until_arrival(observed, scene_with):
    seen = observed(scene_with((3.0, -5.0), (3.0, 5.0)), 20)
    path = paths(OrcaForecaster(), seen[2], steps=8)[0]
    truth = torch.stack([later.pedestrian_position[0] for later in seen[2:11]])
    assert torch.allclose(path, truth, atol=1e-5)


def test_somebody_who_walks_slowly_is_expected_to_stop_soon(observed, scene_with):
    seen = observed(scene_with((3.0, -2.0), (3.0, 0.0)), 40)
    slow = next(each for each in seen[2:] if each.pedestrian_velocity.norm() < 0.9)
    path = paths(OrcaForecaster(), slow, steps=24)[0]
    assert (path[-1] - path[0]).norm() < 1.01


def test_who_is_turned_aside_is_still_expected_at_its_goal(observed, scene_with):
    scene = scene_with((-3.0, 0.0), (3.0, 0.0))
    pair = torch.tensor([[-3.0, 0.0], [3.0, 0.3]], dtype=torch.float64)
    pedestrians = map_tensors(lambda entry: torch.cat((entry, entry)), scene.pedestrians)
    pedestrians = pedestrians._replace(position=pair, goal=-pair)
    seen = observed(scene._replace(pedestrians=pedestrians), 16)
    truth = torch.stack([later.pedestrian_position for later in seen[4:17]], -2)
    path = paths(OrcaForecaster(), *seen[:5], steps=12)
    straight = paths(ConstantVelocityForecaster(), seen[4], steps=12)
    error = (path - truth).norm(dim=-1).max()
    assert float(error) < 0.5 * float((straight - truth).norm(dim=-1).max())


@pytest.mark.parametrize("beside_s", [0.0, 0.1], ids=["that began anew", "that goes on"])
def test_goals_of_overlapping_pedestrians_are_asked_for_with_the_step_of_the_observations(
    observed, scene_with, beside_s
):
    """ORCA parts overlapping discs within one step, here 0.1 s; the plan's step is 0.25 s.

    Beside it is another episode, 5 s old at first.
    """
    scene = scene_with((3.0, 0.0), (3.0, 8.0))
    place = torch.tensor([[3.0, 0.0], [3.55, 0.0]], dtype=torch.float64)
    goal = torch.tensor([[3.0, 8.0], [-8.0, 4.0]], dtype=torch.float64)
    pair = map_tensors(lambda entry: torch.cat((entry, entry)), scene.pedestrians)
    pair = pair._replace(position=place, goal=goal)
    first, second = (
        map_tensors(lambda entry: torch.stack((entry, entry)), each)
        for each in observed(scene._replace(pedestrians=pair), 1, dt_s=0.1)
    )
    other = 5.0 + beside_s if beside_s else 0.0
    first = first._replace(time=torch.tensor([0.0, 5.0]).double())
    second = second._replace(time=torch.tensor([0.1, other]).double())
    forecaster = OrcaForecaster()
    _, state = forecaster(forecaster(None, first, 0.25, 4).state, second, 0.25, 4)
    ways = state.crowd.goal[0, 1] - place[1], goal[1] - place[1]
    assert torch.cosine_similarity(*ways, dim=-1) > 0.99


def test_slow_in_a_crowd_is_not_taken_for_arriving(observed, scenario_of):
    seen = observed(scenario_of("circle", humans=10).cases("test", range(8)), 20)
    truth = torch.stack([later.pedestrian_position for later in seen[8:21]], -2)
    path = paths(OrcaForecaster(), *seen[:9], steps=12)
    slow = seen[8].pedestrian_velocity.norm(dim=-1) < 0.8
    walked = (path[..., -1, :] - path[..., 0, :]).norm(dim=-1)[slow]
    truly = (truth[..., -1, :] - truth[..., 0, :]).norm(dim=-1)[slow]
    assert int(slow.sum()) > 5
    assert float(walked.mean()) > 0.8 * float(truly.mean())


def test_what_is_remembered_goes_in_and_comes_out(observed, scenario_of):
    """One forecaster serves two crowds in turn, as if each had its own."""
    first, second = (observed(scenario_of("circle").cases("test", [case]), 3) for case in (0, 1))
    forecaster, states = OrcaForecaster(), [None, None]
    for pair in zip(first, second, strict=True):
        for number, seen in enumerate(pair):
            forecast, states[number] = forecaster(states[number], seen, 0.25, 4)
    assert torch.equal(forecast.most_likely(), paths(OrcaForecaster(), *second)[..., 1:, :])


@pytest.mark.parametrize(
    ("name", "value"),
    [("preferred_speed_mps", 0.0), ("directions", 0), ("stays", 2.0)],
)
def test_numbers_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        OrcaForecaster(OrcaCrowd(), **{name: value})


@pytest.mark.parametrize(("shares", "weights"), [((3, 1), (0.75, 0.25)), ((0.2, 0.2), (0.5, 0.5))])
def test_a_mixture_of_forecasts_has_the_weights_of_its_shares(
    observed, scene_with, shares, weights
):
    seen = observed(scene_with((3.0, 0.0), (-6.0, 0.0)), 1)[-1]
    mixed = MixedForecaster([ConstantVelocityForecaster(), StandingForecaster()], shares)
    weight = mixed(mixed.init(seen), seen, 0.25, 4)[0].log_weight.exp().flatten()
    assert weight.tolist() == pytest.approx(list(weights))


PEOPLE = ("pedestrian_position", "pedestrian_velocity", "pedestrian_radius", "seen")


def test_nobody_around_is_forecast_as_nobody(observed, scenario_of):
    seen = [
        each._replace(**{name: getattr(each, name)[:, :0] for name in PEOPLE})
        for each in observed(scenario_of("circle").cases("test", [0, 1]), 2)
    ]
    assert paths(OrcaForecaster(), *seen).shape == (2, 0, 5, 2)
