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


def inferred(truth, steps, shown):
    """Goals after some steps of a crowd of which only the first `shown` are seen."""
    model, inference = OrcaCrowd(max_neighbors=20), GoalInference()
    doubt = torch.zeros(shown, inference.courses, dtype=torch.float64)
    goal = truth.position[:shown]
    for _ in range(steps):
        seen = CrowdState(*(field[:shown] for field in truth))._replace(goal=goal)
        truth = truth.moved(model(truth, DT_S), DT_S)
        told = inference(model, seen, truth.velocity[:shown], doubt, DT_S)
        goal, doubt = told.goal, told.doubt
    return truth, goal


def turned_deg(crowd, goal):
    """Angle in degrees between the true course to the goal and the inferred one."""
    ways = torch.stack([goal, crowd.goal[: len(goal)]]) - crowd.position[: len(goal)]
    cosine = torch.cosine_similarity(ways[0], ways[1], dim=-1)
    return torch.rad2deg(cosine.clamp(-1, 1).acos())


def test_the_course_of_who_walks_alone_is_known_after_one_step():
    crowd, goal = inferred(crowd_of((0.0, 0.0, 6.0, 3.0)), 1, 1)
    assert turned_deg(crowd, goal).max() < 1.0


def test_goals_are_known_behind_an_avoidance_of_somebody_out_of_sight():
    crowd, goal = inferred(crowd_of((0.0, 0.0, 8.0, 0.0), (3.0, 0.1, -8.0, 0.1)), 8, 1)
    assert turned_deg(crowd, goal).max() < 25.0
    assert (goal - crowd.position[:1]).norm(dim=-1).min() > 6.0


@pytest.mark.parametrize(
    ("name", "value"),
    [("far_m", 0.0), ("tolerance_mps", 0.0), ("courses", 2), ("refinements", 0), ("memory", 1.5)],
)
def test_impossible_numbers_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        GoalInference(**{name: value})
