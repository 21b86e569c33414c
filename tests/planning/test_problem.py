"""Planning problems from observations."""

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3
from diffstack_mmv.geometry import rotate
from diffstack_mmv.planning.problem import (
    bent_to_goal,
    build_problem,
    disc_radius,
    end_discs,
    facing_the_goal,
    filled_up,
    initial_state,
    likeliest,
    observed_obstacles,
    possible,
    predicted_obstacles,
    predicted_reference,
    straight_reference,
    straightened,
    tracked_ego,
)
from diffstack_mmv.prediction.goal_baselines import hermite_spline
from diffstack_mmv.types import Discs, Ego, Forecast, HeadingOf, Motion, Obstacles, Tracks
from diffstack_mmv.vehicles import load_vehicle


def tracks(*shape, rows):
    motion = Motion(
        torch.randn(*shape, rows, 2),
        torch.randn(*shape, rows),
        torch.randn(*shape, rows, 2),
        torch.randn(*shape, rows),
    )
    valid = torch.ones(*shape, rows, dtype=torch.bool)
    return Tracks(motion, torch.rand(*shape, 2) + 0.5, torch.zeros(*shape, dtype=torch.long), valid)


def problem_of(ego, path, goal, obstacles):
    """As the stack builds its problems."""
    motion = ego.present().motion
    reference = predicted_reference(motion, path, goal, 0.1)
    return build_problem(tracked_ego(motion, ego.extent, goal), goal, reference, obstacles)


def test_reference_ends_at_the_goal_and_starts_where_the_ego_is():
    motion = Motion(*(field[:, 0] for field in tracks(3, rows=1).motion))
    goal = torch.randn(3, 2)
    reference = predicted_reference(motion, torch.randn(3, 30, 2), goal, 0.1).path
    assert reference.shape == (3, 31, 2)
    assert torch.allclose(reference[:, 0], motion.position)
    assert torch.allclose(reference[:, -1], goal, atol=1e-5)


def test_reference_of_constant_velocity_is_the_hermite_spline():
    velocity, goal = torch.tensor([3.0, 0.0]), torch.tensor([7.0, 1.0])
    path = velocity * 0.1 * torch.arange(1, 31).unsqueeze(-1)
    motion = Motion(torch.zeros(2), torch.tensor(0.0), velocity, torch.tensor(0.0))
    expected = hermite_spline(motion, goal, 30, 0.1)
    assert torch.allclose(bent_to_goal(path, goal), expected, atol=1e-5)


def test_reference_turns_with_the_scene():
    path, goal, angle = torch.randn(30, 2), torch.randn(2), torch.tensor(0.7)
    again = bent_to_goal(rotate(path, angle.expand(30)), rotate(goal, angle))
    expected = rotate(bent_to_goal(path, goal), angle.expand(30))
    assert torch.allclose(again, expected, atol=1e-5)


def test_true_obstacles_hold_the_last_seen_position():
    past, future = tracks(2, 3, rows=5), tracks(2, 3, rows=4)
    future.valid[0, 0, 2:] = False
    future.valid[0, 1, :] = False
    position = observed_obstacles(past, future).position
    assert position.shape == (2, 3, 1, 5, 2)
    assert torch.equal(position[0, 0, 0, 3], future.motion.position[0, 0, 1])
    assert torch.equal(position[0, 1, 0, 4], past.motion.position[0, 1, -1])
    assert torch.equal(position[1, 2, 0, 1:], future.motion.position[1, 2])


def test_predicted_obstacles_begin_at_the_present_position():
    neighbors = tracks(2, 3, rows=5)
    forecast = Forecast(
        torch.zeros(2, 3, 4).log_softmax(-1),
        torch.randn(2, 3, 4, 6, 2),
        torch.zeros(2, 3, 4, 6, 2, 2),
    )
    now = neighbors.present()
    radius = disc_radius(neighbors.extent)
    obstacles = predicted_obstacles(now.motion.position, radius, now.valid, forecast)
    assert torch.equal(obstacles.position[:, :, 1, 0], neighbors.motion.position[..., -1, :])
    assert torch.equal(obstacles.position[..., 1:, :], forecast.mean)
    assert torch.allclose(obstacles.weight.sum(-1), torch.ones(2, 3))


def test_disc_has_the_area_of_the_box():
    radius = disc_radius(torch.tensor([4.0, 2.0]))
    assert torch.pi * radius.square() == pytest.approx(8.0)


@pytest.mark.parametrize(("length", "width", "reach"), [(1.8, 0.6, 0.6), (0.6, 1.0, 0.0)])
def test_discs_at_the_ends_of_a_box_have_a_hull_as_long_and_as_wide(length, width, reach):
    ahead, radius = end_discs(torch.tensor([[length, width]]))
    assert ahead.tolist() == [pytest.approx([-reach, reach])]
    assert radius.tolist() == [pytest.approx([width / 2, width / 2])]


def test_the_likeliest_component_of_each_agent_is_taken_as_sure():
    weight = torch.tensor([[[0.2, 0.8], [0.7, 0.3]], [[0.9, 0.1], [0.4, 0.6]]])
    size, position = torch.rand(2, 2), torch.randn(2, 2, 2, 4, 2)
    found = likeliest(Obstacles(position, weight, size, size > 0.5))
    best = [[position[0, 0, 1], position[0, 1, 0]], [position[1, 0, 0], position[1, 1, 1]]]
    assert torch.equal(found.position[:, :, 0], torch.stack([torch.stack(row) for row in best]))
    assert torch.equal(found.weight, torch.ones(2, 2, 1))
    assert torch.equal(found.radius, size)


def test_a_straightened_path_begins_and_ends_alike_and_keeps_its_speed():
    """It begins where the ego is now, a step before the first position."""
    path = torch.tensor([[[1.5, 1.0], [2.0, 2.0], [9.0, 9.0], [7.0, 0.0]]])
    found = straightened(path, torch.tensor([[5.0, 4.0]]))
    assert found.tolist() == [[[2.0, 1.0], [3.0, 2.0], [4.0, 3.0], [5.0, 4.0]]]
    one = straightened(path[:, :1], torch.tensor([[5.0, 4.0]]))
    assert one.tolist() == [[[5.0, 4.0]]]


def test_the_speed_of_a_predicted_reference_is_its_length_by_its_time():
    motion = Motion(torch.zeros(1, 2), torch.zeros(1), torch.zeros(1, 2), torch.zeros(1))
    path = torch.tensor([[[3.0, 0.0], [3.0, 4.0]]])
    speed = predicted_reference(motion, path, path[:, -1], 0.5).speed
    assert speed.tolist() == pytest.approx([7.0])


def test_problem_without_neighbors_is_a_problem():
    ego = tracks(2, rows=5)
    none = observed_obstacles(tracks(2, 0, rows=5), tracks(2, 0, rows=6))
    problem = problem_of(ego, torch.randn(2, 6, 2), torch.randn(2, 2), none)
    assert problem.obstacles.position.shape == (2, 0, 1, 7, 2)
    assert torch.isfinite(problem.reference_speed).all()


@pytest.mark.parametrize(
    ("speed", "goal", "heading"),
    [
        (0.0, (0.0, 5.0), torch.pi / 2),
        (0.29, (0.0, 1.01), torch.pi / 2),
        (0.31, (0.0, 5.0), 0.0),
        (0.0, (0.0, 0.99), 0.0),
    ],
)
def test_only_who_stands_and_has_somewhere_to_go_faces_the_goal(speed, goal, heading):
    motion = Motion(
        torch.zeros(2), torch.tensor(0.0), torch.tensor([speed, 0.0]), torch.tensor(0.0)
    )
    assert facing_the_goal(motion, torch.tensor(goal)).heading.item() == pytest.approx(heading)


def test_goal_on_the_spot_leaves_gradients_finite():
    goal = torch.zeros(2, requires_grad=True)
    motion = Motion(torch.zeros(2), torch.tensor(0.0), torch.zeros(2), torch.tensor(0.0))
    facing_the_goal(motion, goal).heading.backward()
    assert torch.isfinite(goal.grad).all()


def test_straight_reference_divides_the_way_to_the_goal_evenly():
    motion = Motion(*(field[:, 0] for field in tracks(3, rows=1).motion))
    goal = torch.randn(3, 2)
    path, speed = straight_reference(motion, goal, 12, 2.5)
    assert torch.allclose(path[:, -1], goal)
    assert torch.allclose(path.diff(dim=1), (goal - motion.position).unsqueeze(1) / 12, atol=1e-6)
    assert speed.tolist() == [2.5] * 3


@pytest.mark.parametrize("heading_of", list(HeadingOf))
def test_a_plan_begins_in_the_state_that_its_heading_is_that_of(heading_of):
    """A model with side slip: its body does not point where it goes."""
    model = DiffGM3(load_vehicle("bicycle"))
    forward, turning = torch.tensor([3.0, 0.0]), torch.tensor(0.8)
    motion = Motion(torch.zeros(2), torch.tensor(0.4), forward, turning)
    ego = Ego(motion, heading_of, Discs(torch.zeros(1), torch.ones(1)))
    expected = {HeadingOf.BODY: model.initial_state, HeadingOf.COURSE: model.state_on_course}
    assert torch.equal(initial_state(model, ego), expected[heading_of](motion))
    assert not torch.equal(model.initial_state(motion), model.state_on_course(motion))


def test_the_heading_of_a_track_is_its_course():
    now = tracks(2, rows=3).present()
    assert tracked_ego(now.motion, now.extent, torch.randn(2, 2)).heading_of is HeadingOf.COURSE


@pytest.mark.parametrize(("agents", "filled"), [(0, 0), (1, 4), (4, 4), (5, 8), (9, 16)])
def test_absent_agents_fill_a_batch_up(agents, filled):
    obstacles = Obstacles(
        torch.randn(2, agents, 3, 5, 2),
        torch.rand(2, agents, 3),
        torch.rand(2, agents),
        torch.ones(2, agents, dtype=torch.bool),
    )
    found = filled_up(obstacles)
    assert found.valid.sum() == 2 * agents
    assert [each.shape[1] for each in found] == [filled] * 4
    assert torch.equal(found.position[:, :agents], obstacles.position)


def test_possible_components_are_agents_of_their_own():
    weight = torch.tensor([[[0.5, 0.5], [1.0, 0.0]], [[0.0, 1.0], [1.0, 0.0]]])
    valid = torch.tensor([[True, True], [True, False]])
    position = torch.randn(2, 2, 2, 4, 2)
    agents = Obstacles(position, weight, torch.tensor([[0.3, 0.4], [0.5, 0.6]]), valid)
    found = possible(agents)
    assert found.valid.tolist() == [[True, True, True], [True, False, False]]
    assert found.weight[0, :, 0].tolist() == [0.5, 0.5, 1.0]
    assert found.radius[0].tolist() == pytest.approx([0.3, 0.3, 0.4])
    assert torch.equal(found.position[0, :, 0], position[0].flatten(0, 1)[:3])
    assert torch.equal(found.position[1, 0, 0], position[1, 0, 1])
    assert found.weight[1, 0].item() == 1.0


@pytest.mark.parametrize("there", [True, False])
def test_where_all_components_are_possible_or_none_nothing_changes(there):
    weight, radius, valid = torch.ones(2, 3, 1), torch.ones(2, 3), torch.full((2, 3), there)
    agents = Obstacles(torch.randn(2, 3, 1, 4, 2), weight, radius, valid)
    assert possible(agents) is agents
