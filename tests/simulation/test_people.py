"""Forecasts of people: exact where the model is, and honest about what they cannot know."""

import pytest
import torch

from diffstack_mmv.simulation import ConstantVelocityPeople, OrcaCrowd, OrcaPeople


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


def test_new_episodes_forget_the_old_ones(observed, scenario_of):
    first, second = (observed(scenario_of("circle").cases("test", [case]), 3) for case in (0, 1))
    people, fresh = OrcaPeople(), OrcaPeople()
    for seen in (*first, *second):
        path = people(seen, 0.25, 4)
    for seen in second:
        expected = fresh(seen, 0.25, 4)
    assert torch.equal(path, expected)


@pytest.mark.parametrize("name", ["far_m", "preferred_speed_mps", "tolerance_mps"])
def test_numbers_out_of_range_are_refused(name):
    with pytest.raises(ValueError, match=name):
        OrcaPeople(OrcaCrowd(), **{name: 0.0})
