"""The optional second pedestrian model."""

import importlib
import logging
import sys

import pytest
import torch

from diffstack_mmv.simulation import CircleCrossing, SocialForceCrowd
from diffstack_mmv.simulation.pedestrians import VisibleRobot


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
