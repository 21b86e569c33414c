"""Forecasts of people: exact where the model is, and honest about what they cannot know."""

import pytest
import torch

from diffstack_mmv.simulation import ConstantVelocityPeople, OrcaCrowd, OrcaPeople
from diffstack_mmv.types import map_tensors


def test_constant_velocity_is_a_straight_line(observed, scene_with):
    seen = observed(scene_with((3.0, 0.0), (-6.0, 0.0)), 2)[-1]
    path = ConstantVelocityPeople()(seen, 0.25, 4)
    assert torch.allclose(path.diff(dim=-2), 0.25 * seen.human_velocity.unsqueeze(-2))


def test_the_forecast_begins_where_people_are(observed, scenario_of):
    seen = observed(scenario_of("circle").cases("test", [0, 1]), 3)[-1]
    for people in (ConstantVelocityPeople(), OrcaPeople()):
        assert torch.equal(people(seen, 0.25, 4)[..., 0, :], seen.human_position)


def test_a_lone_walker_is_predicted_exactly_until_arrival(observed, scene_with):
    seen = observed(scene_with((3.0, -5.0), (3.0, 5.0)), 20)
    path = OrcaPeople()(seen[2], 0.25, 8)[0]
    truth = torch.stack([later.human_position[0] for later in seen[2:11]])
    assert torch.allclose(path, truth, atol=1e-5)


def test_somebody_who_walks_slowly_is_expected_to_stop_soon(observed, scene_with):
    seen = observed(scene_with((3.0, -2.0), (3.0, 0.0)), 40)
    slow = next(each for each in seen[2:] if each.human_velocity.norm() < 0.9)
    path = OrcaPeople()(slow, 0.25, 24)[0]
    assert (path[-1] - path[0]).norm() < 1.01


def test_who_is_turned_aside_is_still_expected_at_its_goal(observed, scene_with):
    scene = scene_with((-3.0, 0.0), (3.0, 0.0))
    pair = torch.tensor([[-3.0, 0.0], [3.0, 0.3]], dtype=torch.float64)
    humans = map_tensors(lambda entry: torch.cat((entry, entry)), scene.humans)
    humans = humans._replace(position=pair, goal=-pair)
    seen = observed(scene._replace(humans=humans), 16)
    people, straight = OrcaPeople(), ConstantVelocityPeople()
    truth = torch.stack([later.human_position for later in seen[4:17]], -2)
    for each in seen[:5]:
        path = people(each, 0.25, 12)
    error = (path - truth).norm(dim=-1).max()
    assert float(error) < 0.5 * float((straight(seen[4], 0.25, 12) - truth).norm(dim=-1).max())


def test_slow_in_a_crowd_is_not_taken_for_arriving(observed, scenario_of):
    seen = observed(scenario_of("circle", humans=10).cases("test", range(8)), 20)
    truth = torch.stack([later.human_position for later in seen[8:21]], -2)
    people = OrcaPeople()
    for each in seen[:9]:
        path = people(each, 0.25, 12)
    slow = seen[8].human_velocity.norm(dim=-1) < 0.8
    walked = (path[..., -1, :] - path[..., 0, :]).norm(dim=-1)[slow]
    truly = (truth[..., -1, :] - truth[..., 0, :]).norm(dim=-1)[slow]
    assert int(slow.sum()) > 5
    assert float(walked.mean()) > 0.8 * float(truly.mean())


def test_new_episodes_forget_the_old_ones(observed, scenario_of):
    first, second = (observed(scenario_of("circle").cases("test", [case]), 3) for case in (0, 1))
    people, fresh = OrcaPeople(), OrcaPeople()
    for seen in (*first, *second):
        path = people(seen, 0.25, 4)
    for seen in second:
        expected = fresh(seen, 0.25, 4)
    assert torch.equal(path, expected)


@pytest.mark.parametrize("name", ["far_m", "preferred_speed_mps", "tolerance_mps", "courses"])
def test_numbers_out_of_range_are_refused(name):
    with pytest.raises(ValueError, match=name):
        OrcaPeople(OrcaCrowd(), **{name: 0.0})
