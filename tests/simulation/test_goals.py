"""Goals inferred from walks."""

import pytest
import torch

from diffstack_mmv.simulation.goals import GoalInference
from diffstack_mmv.simulation.pedestrians import CrowdState, OrcaCrowd

DT_S = 0.25


def crowd_of(*places):
    position = torch.tensor(places, dtype=torch.float64)[:, :2]
    goal = torch.tensor(places, dtype=torch.float64)[:, 2:]
    each = torch.ones(len(places), dtype=torch.float64)
    return CrowdState(position, torch.zeros_like(position), goal, 0.3 * each, each)


def inferred(truth, steps, shown, inference=None, turns_at=None):
    """Goals after some steps of a crowd of which only the first `shown` are seen."""
    model, inference = OrcaCrowd(max_neighbors=20), inference or GoalInference()

    def seen(crowd):
        return CrowdState(*(field[:shown] for field in crowd))

    first = seen(truth)
    belief = inference.first(first.position, first.velocity, first.preferred_speed)
    for step in range(steps):
        if step == turns_at:
            truth = truth._replace(goal=-truth.goal)
        before, truth = truth, truth.moved(model(truth, DT_S), DT_S)
        belief = inference(model, seen(before), belief, seen(truth).velocity, DT_S)
    return truth, belief.expected(seen(truth).position)


def turned_deg(crowd, goal):
    """Angle in degrees between the true course to the goal and the inferred one."""
    ways = torch.stack([goal, crowd.goal[: len(goal)]]) - crowd.position[: len(goal)]
    cosine = torch.cosine_similarity(ways[0], ways[1], dim=-1)
    return torch.rad2deg(cosine.clamp(-1, 1).acos())


@pytest.mark.parametrize(
    ("walker", "steps", "turns", "off_deg"),
    [((0.0, 0.0, 6.0, 3.0), 1, {}, 1.0), ((0.0, 0.0, 9.0, 3.0), 10, {"turns_at": 8}, 2.0)],
    ids=["after one step", "half a second after a turn"],
)
def test_the_course_of_who_walks_alone_is_known_soon(walker, steps, turns, off_deg):
    crowd, goal = inferred(crowd_of(walker), steps, 1, **turns)
    assert turned_deg(crowd, goal).max() < off_deg


def test_goals_are_known_behind_an_avoidance_of_somebody_out_of_sight():
    crowd, goal = inferred(crowd_of((0.0, 0.0, 8.0, 0.0), (3.0, 0.1, -8.0, 0.1)), 8, 1)
    assert turned_deg(crowd, goal).max() < 25.0
    assert (goal - crowd.position[:1]).norm(dim=-1).min() > 6.0


def test_a_goal_is_remembered_on_a_detour():
    straight, steps = crowd_of((0.0, 0.0, 12.0, 0.0), (6.0, 0.1, -6.0, 0.1)), 11
    crowd, goal = inferred(straight, steps, 2)
    course = torch.atan2(crowd.velocity[:, 1], crowd.velocity[:, 0])
    assert crowd.velocity[0, 1].abs() > 0.05, course
    assert turned_deg(crowd, goal).max() < 1.5


def test_who_slows_down_at_its_goal_is_not_taken_to_walk_on():
    crowd, goal = inferred(crowd_of((0.0, 0.0, 2.0, 0.5)), 8, 1)
    torch.testing.assert_close(goal, crowd.goal, atol=0.02, rtol=0)


def test_beliefs_are_probabilities_in_falling_order():
    crowd = crowd_of((0.0, 0.0, 6.0, 3.0), (2.0, 1.0, -6.0, 0.0))
    belief = GoalInference().first(crowd.position, crowd.velocity, crowd.preferred_speed)
    torch.testing.assert_close(belief.log_weight.exp().sum(-1), torch.ones(2, dtype=torch.float64))
    assert (belief.log_weight.diff(dim=-1) <= 0).all()


def test_what_is_believed_turns_with_the_crowd():
    turn = torch.tensor([[0.0, -1.0], [1.0, 0.0]], dtype=torch.float64)
    places = torch.tensor([(0.0, 0.0, 8.0, 1.0), (4.0, 0.4, -8.0, 0.0)], dtype=torch.float64)
    turned = (places.unflatten(-1, (2, 2)) @ turn.T).flatten(-2)
    (_, goal), (_, other) = (
        inferred(crowd_of(*places.tolist()), 6, 2),
        inferred(crowd_of(*turned.tolist()), 6, 2),
    )
    torch.testing.assert_close(other, goal @ turn.T, atol=1e-3, rtol=1e-4)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("far_m", 0.0),
        ("courses", 2),
        ("kept", 74),
        ("deviation_mps", 0.0),
        ("unexplained", 0.0),
        ("unexplained", 1.0),
        ("change", 0.0),
        ("change", 1.0),
    ],
)
def test_impossible_numbers_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        GoalInference(**{name: value})
