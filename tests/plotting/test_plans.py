"""What a drawn plan shows."""

import numpy as np
import pytest

from diffstack_mmv.plotting import PlannedScene, draw_scenes


def heading_for(goal):
    """A straight ride to a goal, with a prediction that goes far beyond it."""
    line = np.linspace(0.0, 1.0, 31)[1:, None] * np.asarray(goal, float)
    return PlannedScene(
        title="one",
        past=np.zeros((5, 2)),
        human=line,
        plan=line,
        prediction=3 * line,
        components=3 * line[None],
        weights=np.ones(1),
        goal=np.asarray(goal, float),
        candidates=np.zeros((0, 30, 2)),
        neighbors=np.zeros((0, 30, 2)),
    )


@pytest.mark.parametrize("goal", [(12.0, 0.0), (0.0, 12.0), (-3.0, -9.0), (0.0, 0.0)])
def test_all_of_the_ride_and_its_goal_is_in_view(goal):
    axes = draw_scenes([heading_for(goal)]).axes[0]
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert left < min(goal[0], 0.0) <= max(goal[0], 0.0) < right
    assert bottom < min(goal[1], 0.0) <= max(goal[1], 0.0) < top


def test_a_goal_that_was_not_recorded_is_left_out_of_the_view():
    scene = heading_for((4.0, 1.0))._replace(goal=np.full(2, np.nan))
    assert np.isfinite(draw_scenes([scene]).axes[0].get_xlim()).all()


def test_everything_drawn_is_named_once_for_all_panels():
    alone = heading_for((4.0, 1.0))
    among_others = alone._replace(neighbors=np.ones((2, 30, 2)), candidates=np.ones((3, 30, 2)))
    figure = draw_scenes([alone, among_others])
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    drawn = {line.get_label() for axes in figure.axes for line in axes.get_lines()}
    assert len(named) == len(set(named))
    assert set(named) == {label for label in drawn if not label.startswith("_")}
    assert {"candidates", "others, from the square", "plan", "prediction"} <= set(named)


@pytest.mark.parametrize("count", [1, 16])
def test_the_heaviest_component_is_opaque_however_many_there_are(count):
    line = np.ones((1, 30, 2))
    weights = np.linspace(0.5, 1.0, count) / count
    scene = heading_for((4.0, 1.0))._replace(
        components=np.repeat(line, count, axis=0), weights=weights
    )
    lines = draw_scenes([scene]).axes[0].get_lines()
    opacity = [line.get_alpha() for line in lines if "components" in line.get_label()]
    assert len(opacity) == count
    assert opacity[-1] == 1.0
