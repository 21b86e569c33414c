"""The optional second pedestrian model."""

import importlib
import logging
import sys

import numpy as np
import pytest
import torch

from diffstack_mmv.simulation import CircleCrossing, SocialForceCrowd
from diffstack_mmv.simulation.pedestrians import CrowdState, VisibleRobot, social_force


@pytest.fixture
def crowd():
    return CircleCrossing(humans=3).cases("test", range(2)).pedestrians


def test_a_missing_library_is_named_with_its_remedy(monkeypatch):
    def refuse(name):
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr(importlib, "import_module", refuse)
    with pytest.raises(ModuleNotFoundError, match=r"pysocialforce.*diffstack_mmv\[crowd\]"):
        SocialForceCrowd()


@pytest.mark.usefixtures("social_force_library")
@pytest.mark.slow
def test_pedestrians_reach_their_goals_without_a_robot(crowd):
    model = SocialForceCrowd()
    for _ in range(60):
        crowd = crowd.moved(model(crowd, 0.25), 0.25)
    assert ((crowd.position - crowd.goal).norm(dim=-1) < 0.5).all()


@pytest.mark.usefixtures("social_force_library")
@pytest.mark.slow
def test_pedestrians_are_pushed_by_a_robot_that_they_see(crowd):
    place = crowd.position[:, 0] * 0.8
    robot = VisibleRobot(place, torch.zeros_like(place), torch.full((2,), 0.3, dtype=torch.float64))
    change = SocialForceCrowd()(crowd, 0.25, robot) - SocialForceCrowd()(crowd, 0.25)
    assert (change[:, 0].norm(dim=-1) > 0.01).all()


@pytest.mark.usefixtures("social_force_library")
@pytest.mark.slow
def test_a_scene_alone_equals_the_scene_in_a_batch(crowd):
    alone = SocialForceCrowd()(type(crowd)(*(field[1] for field in crowd)), 0.25)
    assert torch.equal(alone, SocialForceCrowd()(crowd, 0.25)[1])


@pytest.mark.usefixtures("social_force_library")
def test_who_stands_exactly_where_others_do_walks_on(crowd):
    """As somebody may who enters a recorded scene; the forces would be NaN."""
    place = crowd.position[:, :1].expand_as(crowd.position).clone()
    robot = VisibleRobot(place[:, 0], torch.zeros_like(place[:, 0]), torch.full((2,), 0.3).double())
    together = crowd._replace(position=place)
    for _ in range(3):
        velocity = SocialForceCrowd()(together, 0.25, robot)
        together = together.moved(velocity, 0.25)
    assert velocity.isfinite().all()
    assert (velocity.norm(dim=-1) > 0.1).all()


@pytest.mark.usefixtures("social_force_library")
def test_loading_the_library_leaves_logging_and_the_folder_alone(monkeypatch, tmp_path):
    for name in [name for name in sys.modules if name.partition(".")[0] == "pysocialforce"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.chdir(tmp_path)
    root = logging.getLogger()
    before = root.level, list(root.handlers)
    SocialForceCrowd()
    assert (root.level, list(root.handlers)) == before
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("setting", "value"), [("max_step_s", 0.0), ("speed_margin", 0.5)])
def test_impossible_settings_are_refused_by_name(setting, value):
    with pytest.raises(ValueError, match=f"`{setting}` must"):
        SocialForceCrowd(**{setting: value})


class Pushing:
    """In place of the library: everybody is pushed alike, and what it was asked is kept."""

    def __init__(self, force):
        self.force, self.states, self.speeds = force, [], []

    def Simulator(self, state):  # noqa: N802
        self.states.append(state.copy())
        return self

    @property
    def peds(self):
        return self

    def __setattr__(self, name, value):
        if name == "max_speeds":
            self.speeds.append(value)
        else:
            super().__setattr__(name, value)

    def compute_forces(self):
        return np.broadcast_to(np.array(self.force), (len(self.states[-1]), 2))


@pytest.fixture
def pushing(monkeypatch):
    """A crowd of two under a constant force, which saw a robot if there is one."""

    def build(force, dt_s, robot=None, speed=5.0, **settings):
        library = Pushing(force)
        monkeypatch.setattr(social_force, "_library", lambda: library)
        place = torch.tensor([[0.0, 0.0], [3.0, 1.0]]).double()
        velocity = torch.tensor([[1.0, 0.0], [0.0, -1.0]]).double()
        flat = torch.full((2,), 0.3).double()
        crowd = CrowdState(place, velocity, 9 * place, flat, torch.full((2,), speed).double())
        return SocialForceCrowd(**settings)(crowd, dt_s, robot), library

    return build


@pytest.mark.parametrize(("dt_s", "pieces"), [(0.25, 3), (0.1, 1), (0.2, 2), (0.3, 3), (0.31, 4)])
def test_a_step_is_cut_into_equal_pieces_over_which_forces_act(pushing, dt_s, pieces):
    mean, library = pushing([0.6, -1.2], dt_s)
    assert len(library.states) == pieces
    # v grows by f h before each piece of h, so that by (n + 1) / 2 of them in the mean
    gained = torch.tensor([0.6, -1.2]).double() * dt_s / pieces * (pieces + 1) / 2
    torch.testing.assert_close(mean, torch.tensor([[1.0, 0.0], [0.0, -1.0]]).double() + gained)


def test_nobody_walks_much_faster_than_preferred(pushing):
    mean, _ = pushing([100.0, 0.0], 0.1, speed=0.5, speed_margin=1.4)
    assert mean.norm(dim=-1).tolist() == pytest.approx([0.7, 0.7])
    slow, _ = pushing([-0.5, 0.0], 0.1, speed=5.0)
    assert slow[0].tolist() == pytest.approx([0.95, 0.0])


def test_a_robot_is_seen_to_drive_on_and_is_not_pushed(pushing):
    robot = VisibleRobot(
        torch.tensor([5.0, 5.0]).double(),
        torch.tensor([0.6, 0.8]).double(),
        torch.tensor(0.3).double(),
    )
    mean, library = pushing([1.0, 1.0], 0.2, robot, speed=2.0)
    assert mean.shape == (2, 2)
    first, second = (state[-1].tolist() for state in library.states)
    assert first == pytest.approx([5.0, 5.0, 0.6, 0.8, 5.6, 5.8])
    assert second == pytest.approx([5.06, 5.08, 0.6, 0.8, 5.6, 5.8])
    assert library.speeds[0].tolist() == pytest.approx([2.0, 2.0, 1.0])
    assert library.states[0][1].tolist() == [3.0, 1.0, 0.0, -1.0, 27.0, 9.0]


def test_all_but_the_first_of_those_in_one_place_stand_aside():
    state = np.zeros((5, 6))
    state[2, 0], state[4, 1] = 1.0, 3.0  # two others are elsewhere
    apart = social_force._apart(state)
    assert (apart != state).any(1).tolist() == [False, True, False, True, False]
    assert len(np.unique(apart[:, :2], axis=0)) == 5
    assert np.abs(apart - state).max() <= 2e-6
    assert not state[1].any()
