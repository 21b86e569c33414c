"""Pictures of episodes."""

import pytest
import torch
from matplotlib.patches import Circle, Polygon

from diffstack_mmv.plotting import CaseStart, draw_episode, episode_of, save_story, worth_showing
from diffstack_mmv.types import EpisodeRecord, Motion, Outcome

START = CaseStart([0.3, 0.3, 0.5], (0.0, 4.0))


@pytest.fixture
def record():
    motion = Motion(torch.rand(2, 4, 2), torch.zeros(2, 4), torch.zeros(2, 4, 2), torch.zeros(2, 4))
    outcome = torch.tensor([int(Outcome.SUCCESS), int(Outcome.COLLISION)])
    return EpisodeRecord(
        motion=motion,
        pedestrians=torch.rand(2, 4, 3, 2),
        controls=torch.zeros(2, 3, 2),
        reward=torch.zeros(2, 3),
        clearance=torch.ones(2, 4),
        outcome=outcome,
        steps=torch.tensor([3, 2]),
        duration=torch.tensor([0.75, 0.5]),
        dt_s=0.25,
    )


def test_an_episode_is_cut_at_its_end(record):
    assert episode_of(record, 1, 7, START).record.pedestrians.shape == (3, 3, 2)


def test_who_is_absent_is_not_drawn(record):
    record.pedestrians[0, :2, 1] = torch.nan
    (axes,) = draw_episode(episode_of(record, 0, 4, START)).axes
    assert torch.tensor(axes.get_xlim()).isfinite().all()
    circles = [patch for patch in axes.patches if isinstance(patch, Circle)]
    assert all(torch.tensor(circle.center).isfinite().all() for circle in circles)


def test_the_legend_stands_below_the_picture_and_names_the_heading(record):
    figure = draw_episode(episode_of(record, 0, 4, START))
    assert figure.axes[0].get_legend() is None
    [legend] = figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == ["robot, each second", "heading", "pedestrians", "goal"]


def test_nobody_around_is_drawn_as_well(record):
    alone = record._replace(pedestrians=torch.zeros(2, 4, 0, 2))
    (axes,) = draw_episode(episode_of(alone, 0, 4, CaseStart([], (0.0, 4.0)))).axes
    assert axes.get_xlim()[1] > 4.0


def test_everybody_is_as_large_as_in_the_case(record):
    (axes,) = draw_episode(episode_of(record, 0, 4, START)).axes
    people = [patch.radius for patch in axes.patches if isinstance(patch, Circle)][:3]
    assert people == START.radii_m


FAILED, ARRIVED = int(Outcome.COLLISION), int(Outcome.SUCCESS)


@pytest.mark.parametrize(
    ("count", "asked", "shown"),
    [(1, (), [7]), (2, (), [7, 4]), (0, [4], [4]), (1, [4], [4, 7])],
)
def test_cases_asked_for_and_then_failures_are_worth_showing(count, asked, shown):
    assert worth_showing({4: ARRIVED, 7: FAILED, 9: ARRIVED}, count, asked) == shown


def test_the_story_of_a_case_is_a_picture_and_a_moving_one(record, tmp_path):
    save_story(tmp_path, episode_of(record, 1, 7, START))
    names = sorted(path.name for path in (tmp_path / "plots").iterdir())
    assert names == ["case_7.gif", "case_7.png"]


def test_the_outline_of_the_robot_turns_with_its_heading(record):
    box = torch.tensor([[1.0, 0.3], [-1.0, 0.3], [-1.0, -0.3], [1.0, -0.3]])
    turned = record._replace(
        motion=record.motion._replace(heading=torch.full((2, 4), torch.pi / 2))
    )
    drawn = draw_episode(episode_of(turned, 0, 4, START, outline=box))
    (axes,) = drawn.axes
    last = [patch for patch in axes.patches if isinstance(patch, Polygon)][-1]
    corners = torch.tensor(last.get_xy()[:4]) - turned.motion.position[0, -1]
    assert torch.allclose(corners.float(), box.flip(-1) * torch.tensor([-1.0, 1.0]), atol=1e-6)


def test_a_case_that_was_not_driven_cannot_be_shown():
    with pytest.raises(ValueError, match=r"among 4 to 7, but got \[5\]"):
        worth_showing({4: ARRIVED, 7: FAILED}, 0, [5])
