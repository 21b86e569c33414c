"""The arcs on which a pursuit leaves, by hand."""

import math

import pytest
import torch

from diffstack_mmv.dynamics import ExtendedUnicycle
from diffstack_mmv.planning.pursuit import Leg, Pursuit
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import load_vehicle

DT_S = 0.25
TO_GOAL = (0.0, 1.0, False)


def arc(distance, bearing, speed, cruise, leg=TO_GOAL, **settings):
    """Target speed in m/s and curvature in 1/m with the goal in this direction of the body."""
    model = ExtendedUnicycle(load_vehicle("bicycle"), DT_S).double()
    heading, place = 2.0, torch.tensor([[3.0, -7.0]]).double()
    number = place.new_tensor
    motion = Motion(place, number([heading]), number([[speed, 0.0]]), number([0.0]))
    way = [distance * math.cos(heading + bearing), distance * math.sin(heading + bearing)]
    offset, share, detours = leg
    given = Leg(
        offset=number([offset]), speed_share=number([share]), detours=torch.tensor([detours])
    )
    found = Pursuit(**settings).arc(
        model, model.initial_state(motion), given, place + number([way]), number([cruise])
    )
    return float(found.acceleration) * DT_S + speed, float(found.curvature)


@pytest.mark.parametrize(
    ("distance", "bearing", "cruise", "target"),
    [
        (50.0, 0.0, 4.0, 4.0),  # nothing is in the way of the cruise
        (0.5, 0.0, 4.0, math.sqrt(2 * 2.5 * 0.5)),  # it brakes at 2.5 m/s²
        (10.0, 0.6, 8.0, math.sqrt(4.0 * 5.0 / math.sin(0.6))),  # 4 m/s² on the arc to the goal
        (10.0, -0.6, 8.0, math.sqrt(4.0 * 5.0 / math.sin(0.6))),
        (1.0, 1.2, 8.0, 2.5 * 0.5 / math.sin(1.2)),  # 2.5 rad/s on it
        (4.0, 2.5, 8.0, math.sqrt(4.0 * 2.0)),  # of half the distance as radius to what is behind
    ],
)
def test_the_goal_is_made_for_as_fast_as_the_arc_and_braking_allow(
    distance, bearing, cruise, target
):
    assert arc(distance, bearing, 3.0, cruise)[0] == pytest.approx(target)


@pytest.mark.parametrize(
    ("speed", "bearing", "curvature"),
    [
        (2.0, 0.2, 0.2 / (0.3 * 2.0)),  # an error of the course is steered out in 0.3 s
        (2.0, -0.2, -0.2 / (0.3 * 2.0)),
        (3.0, 0.6, 4.0 / 9.0),  # with 4 m/s² at most
        (3.0, -0.6, -4.0 / 9.0),
        (0.1, 0.6, 0.6 / (0.3 * 0.5)),  # as at half a metre per second, if slower
    ],
)
def test_an_error_of_the_course_is_steered_out_within_what_tyres_hold(speed, bearing, curvature):
    assert arc(10.0, bearing, speed, 4.0)[1] == pytest.approx(curvature)


def test_a_detour_leads_aside_at_its_share_of_the_cruise():
    target, curvature = arc(40.0, 0.1, 2.0, 6.0, leg=(0.4, 0.5, True))
    assert target == pytest.approx(3.0)
    assert curvature == pytest.approx(0.5 / (0.3 * 2.0))
    aside, _ = arc(40.0, 1.4, 2.0, 6.0, leg=(0.0, 1.0, True))
    assert aside == pytest.approx(6.0)  # whatever the arc to the goal would allow


@pytest.mark.parametrize(("share", "target"), [(-0.1, -0.6), (-0.5, -1.0)])
def test_backwards_it_steers_the_other_way_and_no_faster_than_a_walk(share, target):
    found, curvature = arc(40.0, 0.0, 0.0, 6.0, leg=(math.pi - 0.3, share, True))
    assert found == pytest.approx(target)
    assert curvature == pytest.approx(0.3 / (0.3 * 0.5))


@pytest.mark.parametrize(
    "name", ["turn_time_s", "lateral_mps2", "yaw_rate_radps", "braking_mps2", "backing_mps"]
)
def test_a_number_that_is_not_positive_is_refused_by_name(name):
    with pytest.raises(ValueError, match=f"`{name}` must be positive"):
        Pursuit(**{name: 0.0})
