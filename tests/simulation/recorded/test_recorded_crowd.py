"""A crowd with its recording, of a few rows made by hand; and passages on a small grid."""

import numpy as np
import pytest
import torch

from diffstack_mmv.simulation import DiscFootprint, OrcaCrowd, ReactiveReplayCrowd, ReplayCrowd
from diffstack_mmv.simulation.pedestrians import VisibleRobot
from diffstack_mmv.simulation.pedestrians.recorded import far_away
from diffstack_mmv.simulation.recorded.case_scene import case_scene
from diffstack_mmv.simulation.recorded.crossing import Crossing, RecordedRows
from diffstack_mmv.simulation.recorded.passage import PassageRules, Walks, _bend, _reaches_end
from diffstack_mmv.simulation.verdict import Encounter, RobotPath, clearance_at_rest
from diffstack_mmv.simulation.verdicts import CrowdNavVerdict, ExactVerdict
from diffstack_mmv.types import Motion, map_tensors

STEP_S, LEAD, WAY_M = 0.5, 2, 10.0
# one walks along x all the time, one enters in the fourth row and leaves after the fifth
TRACKS = np.array(
    [
        [[0.0, 0.0], [0.4, 0.0], [1.0, 0.0], [1.6, 0.0], [2.4, 0.2], [3.0, 0.2]],
        [[9.0, 9.0], [5.0, 5.0], [5.0, 5.0], [5.0, 4.0], [5.0, 3.5], [5.0, 3.5]],
    ]
)
INSIDE = np.array([[False, True, True, True, True, True], [False, False, False, True, True, False]])


def scene(room=3):
    rows = RecordedRows(TRACKS, INSIDE, np.array([0.25, 0.4]))
    return case_scene(rows, LEAD, STEP_S, WAY_M, room)


def walked(steps):
    """The crowd after so many steps as recorded."""
    crowd = scene().pedestrians
    for _ in range(steps):
        crowd = crowd.moved(ReplayCrowd()(crowd, STEP_S), STEP_S)
    return crowd


def test_a_scene_begins_with_those_who_are_there_as_fast_as_they_came():
    made = scene()
    crowd = made.pedestrians
    assert made.robot_position.tolist() == [0.0, -5.0]
    assert made.robot_goal.tolist() == [0.0, 5.0]
    assert float(made.robot_heading) == pytest.approx(np.pi / 2)
    assert crowd.present.tolist() == [True, False, False]
    assert crowd.position[0].tolist() == [1.0, 0.0]
    assert crowd.velocity[0].tolist() == pytest.approx([0.6 / STEP_S, 0.0])
    assert not crowd.velocity[1:].any()
    assert crowd.radius.tolist() == [0.25, 0.4, 0.3]
    # where each was seen last, and the mean speed of the steps in which it was there
    assert crowd.goal.tolist() == [[3.0, 0.2], [5.0, 3.5], [0.0, 0.0]]
    mean = (0.4 + 0.6 + 0.6 + np.hypot(0.8, 0.2) + 0.6) / 5
    expected = [mean / STEP_S, (1.0 + 0.5) / 2 / STEP_S, 0.1]
    assert crowd.preferred_speed.tolist() == pytest.approx(expected)


@pytest.mark.parametrize("kind", [CrowdNavVerdict, ExactVerdict])
def test_who_is_absent_has_no_clearance(kind):
    """They were told to be a kilometre away, which is where they are kept."""
    still = torch.zeros(1, 2, dtype=torch.float64)
    path = RobotPath(still.expand(3, 2), still[:, 0].expand(3))
    crowd = map_tensors(lambda field: field.clone(), scene().pedestrians)
    step = Encounter(
        path, DiscFootprint(0.3), still[0], crowd, still.expand(3, 2), still[0], still[0, 0], STEP_S
    )
    motion = Motion(still[0], still[0, 0], still[0], still[0, 0])
    nobody = crowd._replace(inside=torch.zeros_like(crowd.inside))
    for people, expected in ((crowd, 1.0 - 0.25 - 0.3), (nobody, np.inf)):
        told = (
            kind(9.0)(step._replace(pedestrians=people)).clearance,
            clearance_at_rest(motion, step.footprint, people),
        )
        assert list(map(float, told)) == pytest.approx([expected] * 2)


def test_who_enters_has_come_from_where_it_was_recorded_and_who_leaves_is_far_away():
    crowd = walked(1)
    assert crowd.present.tolist() == [True, True, False]
    assert crowd.position[:2].tolist() == [[1.6, 0.0], [5.0, 4.0]]
    assert crowd.velocity[1].tolist() == pytest.approx([0.0, -1.0 / STEP_S])
    crowd = walked(3)
    assert crowd.present.tolist() == [True, False, False]
    assert torch.equal(crowd.position[1:], far_away(crowd.position)[1:])
    assert not crowd.velocity[1:].any()


def test_who_stays_moves_as_it_likes_and_who_enters_as_recorded():
    crowd = walked(0)
    assert crowd.stays().tolist() == [True, False, False]
    moved = crowd.moved(torch.full((3, 2), 0.25).double(), STEP_S)
    assert moved.position[:2].tolist() == [[1.125, 0.125], [5.0, 4.0]]
    assert moved.velocity[:2].tolist() == [[0.25, 0.25], [0.0, -2.0]]
    assert moved.stays().tolist() == [True, True, False]
    assert walked(2).stays().tolist() == [True, False, False]


def test_those_who_are_absent_are_far_from_everything_and_from_each_other():
    place = far_away(torch.zeros(2, 3, 2).double())
    assert place.shape == (2, 3, 2)
    assert float(place.min()) >= 1000
    assert float(torch.pdist(place[1]).min()) == pytest.approx(20.0)


def test_nobody_is_there_after_the_last_row():
    crowd = walked(3)
    assert int(crowd.row) == 5
    assert crowd.inside_after(0).tolist() == [True, False, False]
    assert not crowd.inside_after(1).any()
    assert crowd.recorded(1)[0].tolist() == [3.0, 0.2]
    assert not ReplayCrowd()(crowd, STEP_S).any()


def test_the_future_is_that_of_the_recording_and_who_leaves_stays_where_it_was():
    future = walked(1).future(3)
    assert future[0].tolist() == [[2.4, 0.2], [3.0, 0.2], [3.0, 0.2]]
    assert future[1].tolist() == [[5.0, 3.5]] * 3


def test_the_past_has_the_velocities_of_the_steps_that_led_to_its_rows():
    history = walked(1).history()
    assert history.present.tolist() == [[False, True], [False, False], [False, False]]
    assert history.position[0].tolist() == [[0.0, 0.0], [0.4, 0.0]]
    assert history.velocity[0].flatten().tolist() == pytest.approx([0.0, 0.0, 0.8, 0.0])
    assert not history.velocity[1:].any()
    assert history.step_s == STEP_S


def reacting(away, robot_m, **settings):
    """What the first one does who is off its way, beside a robot at rest this far ahead."""
    crowd = walked(1)
    place = crowd.position.clone()
    place[0] += torch.tensor(away)
    crowd = crowd._replace(position=place)
    at = place[0] + torch.tensor([robot_m, 0.0])
    robot = VisibleRobot(at, torch.zeros_like(at), at.new_tensor(0.3))
    return ReactiveReplayCrowd(**settings)(crowd, STEP_S, robot)[0].tolist()


@pytest.mark.parametrize(
    ("away", "settings", "velocity"),
    [
        ([0.0, 0.1], {"return_s": 1.0}, [1.4, 0.1]),  # to (3.0, 0.2) in a second
        ([0.0, 0.1], {"return_s": 0.5, "hurry": 9.0}, [1.6, 0.2]),  # to (2.4, 0.2) in half of one
        ([0.0, 0.1], {"return_s": 4.0}, [1.4 / 4, 0.1 / 4]),  # to where the recording ends
        ([0.0, 0.0], {}, [0.8 / 0.5, 0.2 / 0.5]),  # as recorded
    ],
)
def test_who_is_off_its_way_heads_for_where_the_recording_is_later(away, settings, velocity):
    assert reacting(away, 50.0, **settings) == pytest.approx(velocity)


@pytest.mark.parametrize(("hurry", "least", "speed"), [(1.5, 0.8, 1.5), (1.0, 2.0, 2.0)])
def test_nobody_returns_faster_than_in_a_hurry(hurry, least, speed):
    found = reacting([0.0, -9.0], 50.0, hurry=hurry, speed_min_mps=least)
    preferred = float(scene().pedestrians.preferred_speed[0])
    most = max(hurry * preferred, least)
    assert np.hypot(*found) == pytest.approx(most)
    assert found[1] / found[0] == pytest.approx(9.2 / 1.4)


@pytest.mark.parametrize(("robot_m", "avoids"), [(2.5, True), (2.6, False)])
def test_a_robot_is_avoided_where_its_outline_is_near(robot_m, avoids):
    # the radii are 0.25 and 0.3 m
    avoidance = OrcaCrowd(time_horizon_s=3.0, margin_m=0.1)
    found = reacting([0.0, 0.0], robot_m, near_m=2.0, avoidance=avoidance)
    assert (found != pytest.approx([1.6, 0.4], abs=1e-3)) == avoids


@pytest.mark.parametrize("heading", [np.pi / 2, 0.0, 2.5])
def test_the_way_of_a_crossing_leads_along_y(heading):
    crossing = Crossing(np.array([3.0, -2.0]), heading)
    along = crossing.centre + 4 * np.array([np.cos(heading), np.sin(heading)])
    left = crossing.centre + np.array([-np.sin(heading), np.cos(heading)])
    found = crossing.seen_from(np.stack([crossing.centre, along, left]))
    assert np.allclose(found, [[0.0, 0.0], [0.0, 4.0], [-1.0, 0.0]])


def test_points_of_a_bend_are_equally_far_apart_along_it():
    points = _bend(10.0, 2.0, 0.05)
    assert points[0].tolist() == [0.0, -5.0]
    assert np.allclose(np.linalg.norm(np.diff(points, axis=0), axis=-1), 0.05, atol=1e-4)
    share = points[:, 1] / 10 + 0.5
    assert np.allclose(points[:, 0], 2 * np.sin(np.pi * share) ** 2, atol=1e-4)
    assert 0 < 5.0 - points[-1, 1] <= 0.05


@pytest.mark.parametrize(
    ("points", "speeds", "steps"),
    # from rest the place is 1, 4, 9 ... while the speed rises, then twice its index further
    [(1, 2, 1), (2, 2, 2), (3, 2, 2), (4, 2, 3), (4, 3, 2), (8, 3, 3), (9, 3, 4), (9, 4, 3)],
)
def test_a_free_drive_takes_as_long_as_its_acceleration_and_speed_allow(points, speeds, steps):
    assert _reaches_end(np.ones((steps + 1, points), dtype=bool), speeds)
    assert not _reaches_end(np.ones((steps, points), dtype=bool), speeds)


def test_a_drive_waits_until_the_way_is_free():
    free = np.ones((9, 4), dtype=bool)
    free[:5, 1:] = False  # nothing but the start is free in the first five rows
    assert _reaches_end(free[:8], 2)
    assert not _reaches_end(free[:7], 2)
    free[2, 0] = False
    assert not _reaches_end(free, 2)


@pytest.mark.parametrize(("place", "reached"), [(14, True), (12, False)])
def test_a_drive_does_not_stop_at_once(place, reached):
    """From place 9 at index 3 the next index is 2 or 3, and the place at least 5 further."""
    free = np.zeros((12, 16), dtype=bool)
    free[range(5), [0, 1, 4, 9, place]] = True
    free[5:] = True
    assert _reaches_end(free, 4) == reached


def test_points_within_the_distance_of_an_outline_are_not_free():
    place = np.zeros((1, 2, 2))
    path = np.array([[0.0, 0.0], [0.74, 0.0], [0.0, -0.76]])
    found = Walks(place, np.array([[True, False]]), np.array([0.25]), 0.25).free(path, 0.5)
    assert found.tolist() == [[False, False, True], [True, True, True]]


@pytest.mark.parametrize(("rows", "passable"), [(14, True), (13, False)])
def test_a_passage_ends_before_the_rows_do(rows, passable):
    """3.9 m at up to 1 m/s, from rest at 1 m/s²: half a metre in the first second, then 3.4 s."""
    rules = PassageRules(speed_max_mps=1.0, acceleration_mps2=1.0)
    far = Walks(np.full((1, rows + 5, 2), 99.0), np.ones((1, rows + 5)) > 0, np.ones(1), 0.25)
    assert rules.passable(far, 3.9, 0.3) == passable


@pytest.mark.parametrize(("x", "passable"), [(0.9, True), (0.65, False)])
def test_who_stands_beside_the_way_is_passed_with_the_margin(x, passable):
    """Radii of 0.3 m each, and 0.25 m between them."""
    beside = Walks(np.full((1, 60, 2), [x, 0.0]), np.ones((1, 60)) > 0, np.array([0.3]), 0.25)
    rules = PassageRules(bulges_m=(0.0,), margin_m=0.25)
    assert rules.passable(beside, 10.0, 0.3) == passable
