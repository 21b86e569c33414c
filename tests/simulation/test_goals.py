"""Goals inferred from walks."""

import math

import pytest
import torch

from diffstack_mmv.simulation.goals import GoalBelief, GoalInference
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


class HeadsStraight(OrcaCrowd):
    """A crowd in which everybody walks to a goal at 1 m/s, whoever is in the way."""

    def responses(self, before, goal, dt_s):
        way = goal - before.position[:, None]
        return way / way.norm(dim=-1, keepdim=True)


def all_around(place, count, far_m):
    angles = [2 * math.pi * number / count for number in range(count)]
    return [(place[0] + far_m * math.cos(a), place[1] + far_m * math.sin(a)) for a in angles]


def test_beliefs_follow_the_rule_of_bayes():
    inference = GoalInference(
        far_m=10.0, courses=4, kept=5, deviation_mps=0.4, unexplained=0.02, change=0.3
    )
    crowd = crowd_of((1.0, 2.0, 0.0, 0.0))
    known = [(6.0, 2.0), (1.0, -3.0)]
    belief = GoalBelief(
        torch.tensor([known], dtype=torch.float64),
        torch.tensor([[0.75, 0.25]], dtype=torch.float64).log(),
    )
    velocity = (0.6, 0.2)
    found = inference(
        HeadsStraight(max_neighbors=20), crowd, belief, crowd.position.new_tensor([velocity]), DT_S
    )
    speed = math.hypot(*velocity)
    ahead = (1.0 + 10 * 0.6 / speed, 2.0 + 10 * 0.2 / speed)
    new = {(1.6, 2.2): 0.02, ahead: 0.2}
    new |= dict.fromkeys(all_around((1.0, 2.0), 4, 10.0), 0.78 / 4)
    weights = {goal: 0.7 * w for goal, w in zip(known, (0.75, 0.25), strict=True)}
    weights |= {goal: 0.3 * weight for goal, weight in new.items()}
    for goal in weights:
        away = math.dist(goal, (1.0, 2.0))
        wanted = [(goal[0] - 1.0) / away, (goal[1] - 2.0) / away]
        error = math.dist(wanted, velocity) / 0.4
        weights[goal] *= 0.98 * math.exp(-(error**2) / 2) + 0.02
    best = sorted(weights.items(), key=lambda item: -item[1])[:5]
    total = sum(weight for _, weight in best)
    for number, (goal, weight) in enumerate(best):
        assert found.goal[0, number].tolist() == pytest.approx(goal)
        assert found.log_weight[0, number].exp().item() == pytest.approx(weight / total)


@pytest.mark.parametrize(
    ("speed", "ahead_m"), [(1.2, 15.0), (1.0, 1.0), (0.3, 0.3)], ids=["full", "slower", "slow"]
)
def test_at_first_sight_full_speed_goes_far_and_less_is_about_to_arrive(speed, ahead_m):
    crowd = crowd_of((1.0, 2.0, 0.0, 0.0))
    velocity = speed * torch.tensor([[0.6, 0.8]], dtype=torch.float64)
    preferred = torch.tensor([1.2], dtype=torch.float64)
    belief = GoalInference(courses=8, kept=9).first(crowd.position, velocity, preferred)
    assert belief.goal[0, 0].tolist() == pytest.approx([1 + 0.6 * ahead_m, 2 + 0.8 * ahead_m])
    assert belief.log_weight[0].exp().tolist() == pytest.approx([0.6] + 8 * [0.05])
    around = sorted(map(tuple, belief.goal[0, 1:].tolist()))
    for found, wanted in zip(around, sorted(all_around((1.0, 2.0), 8, 15.0)), strict=True):
        assert found == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("weights", "expected"),
    [
        ((0.6, 0.4), (5.0, 2.0)),
        ((0.5, 0.5), (1 + 7 / math.sqrt(2), 2 + 7 / math.sqrt(2))),
    ],
    ids=["likelier than all others", "none is"],
)
def test_an_unsure_goal_lies_at_the_mean_distance_in_the_mean_direction(weights, expected):
    place = torch.tensor([[1.0, 2.0]], dtype=torch.float64)
    goal = torch.tensor([[[5.0, 2.0], [1.0, 12.0]]], dtype=torch.float64)
    weight = torch.tensor([weights], dtype=torch.float64)
    found = GoalBelief(goal, weight.log()).expected(place)[0].tolist()
    assert found == pytest.approx(expected)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("far_m", 0.0),
        ("kept", 0),
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
