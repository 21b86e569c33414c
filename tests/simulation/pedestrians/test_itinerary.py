"""Where pedestrians go after their goals."""

import pytest
import torch

from diffstack_mmv.simulation.pedestrians import CrowdState, Itinerary

NEXT = [[[5.0, 0.0], [6.0, 0.0]], [[0.0, 5.0], [0.0, 6.0]], [[7.0, 7.0], [8.0, 8.0]]]
GOAL = [[1.0, 0.0], [0.0, 3.0], [4.0, 4.0]]


def crowd_of(first=(0.0, 0.0)):
    """Three of them, all at the origin but for the first one."""
    position = torch.tensor([list(first), [0.0, 0.0], [0.0, 0.0]])
    flat = torch.tensor([0.3, 0.3, 0.3])
    return CrowdState(position, torch.zeros(3, 2), torch.tensor(GOAL), flat, flat)


def itinerary_of(*taken):
    """The second one gives up its goal after 2 s, the third one after 4 s."""
    gives_up = torch.tensor([[False, False], [True, False], [False, True]])
    return Itinerary(torch.tensor(NEXT), torch.tensor(taken), gives_up, torch.tensor([2.0, 4.0]))


def followed(crowd, itinerary, before, after):
    then, later = itinerary.followed(crowd, torch.tensor(before), torch.tensor(after))
    return then.goal.tolist(), later.taken.tolist()


@pytest.mark.parametrize(("x", "arrived"), [(0.69, False), (0.71, True), (1.29, True)])
def test_who_has_come_to_its_goal_takes_the_next_one(x, arrived):
    goal, taken = followed(crowd_of((x, 0.0)), itinerary_of(0, 0, 0), 0.0, 0.25)
    assert goal == [NEXT[0][0] if arrived else GOAL[0], GOAL[1], GOAL[2]]
    assert taken == [int(arrived), 0, 0]


@pytest.mark.parametrize(
    ("before", "after", "changed"),
    [
        (1.5, 1.75, []),
        (1.75, 2.0, [1]),
        (2.0, 2.25, []),
        (3.9, 4.1, [2]),
        (1.0, 5.0, [1, 2]),
    ],
)
def test_a_goal_is_given_up_in_the_step_that_reaches_its_time(before, after, changed):
    goal, taken = followed(crowd_of(), itinerary_of(0, 0, 0), before, after)
    assert goal == [NEXT[n][0] if n in changed else GOAL[n] for n in range(3)]
    assert taken == [int(n in changed) for n in range(3)]


@pytest.mark.parametrize(("taken", "place"), [(0, 0), (1, 1), (2, 1), (7, 1)])
def test_the_last_goal_of_the_list_is_kept(taken, place):
    goal, later = followed(crowd_of((1.0, 0.0)), itinerary_of(taken, 0, 0), 0.0, 0.25)
    assert goal[0] == NEXT[0][place]
    assert later[0] == taken + 1
