"""Moving pictures of episodes."""

import numpy as np
import pytest
import torch
from PIL import Image

from diffstack_mmv.plotting import (
    CaseStart,
    draw_side_by_side,
    episode_of,
    save_animation,
    save_side_by_side,
)
from diffstack_mmv.plotting.animation import _write, draw_curves
from diffstack_mmv.plotting.episodes import legend_of
from diffstack_mmv.plotting.figures import new_figure
from diffstack_mmv.types import EpisodeRecord, Motion, Outcome


@pytest.fixture
def episode():
    """The robot drives along x for some steps past one pedestrian."""

    def build(steps=2, outcome=Outcome.SUCCESS):
        rows = steps + 1
        way = torch.linspace(0, 1, rows)[None, :, None] * torch.tensor([1.0, 0.0])
        flat = torch.zeros(1, rows)
        record = EpisodeRecord(
            motion=Motion(way, flat, torch.zeros(1, rows, 2), flat),
            pedestrians=torch.ones(1, rows, 1, 2),
            controls=torch.zeros(1, steps, 2),
            reward=torch.zeros(1, steps),
            clearance=torch.ones(1, rows),
            outcome=torch.tensor([int(outcome)]),
            steps=torch.tensor([steps]),
            duration=torch.tensor([0.25 * steps]),
            dt_s=0.25,
        )
        return episode_of(record, 0, 4, CaseStart([0.3], (1.0, 0.0)))

    return build


def test_controllers_stand_in_a_row_under_their_names(episode):
    figure = draw_side_by_side(["ours", "MPPI"], [episode(), episode(3, Outcome.COLLISION)])
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == ["ours: success after 0.50 s", "MPPI: collision after 0.75 s"]


def test_the_one_who_has_ended_waits_for_the_other(episode, tmp_path):
    save_side_by_side(["a", "b"], [episode(1), episode(4)], tmp_path / "both.gif")
    with Image.open(tmp_path / "both.gif") as picture:
        assert picture.n_frames == 5


def test_what_a_controller_tells_of_is_explained_and_nothing_else(episode):
    thinking = episode()._replace(thoughts={"plan": torch.zeros(2, 3, 2)})
    labels = [handle.get_label() for handle in legend_of([episode(), thinking])]
    assert labels == ["robot", "heading", "pedestrians", "goal", "plan"]
    nowhere = episode()._replace(start=CaseStart([0.3]))
    assert "goal" not in [handle.get_label() for handle in legend_of([nowhere])]


def test_controls_carry_names_and_units_over_the_time_of_the_clearance(episode):
    above, below = new_figure().subplots(2, sharex=True)
    named = episode(3)._replace(control_names=("acceleration", "steer"))
    draw_curves(above, below, named)
    labels = [text.get_text() for text in below.get_legend().get_texts()]
    assert labels == ["acceleration [m/s²]", "steer [rad]"]
    assert below.get_xlim() == above.get_xlim()
    below.figure.draw_without_rendering()
    legend = below.get_legend().get_window_extent()
    assert above.get_window_extent().y0 > legend.y1 > legend.y0 >= below.get_window_extent().y1


def test_an_episode_becomes_an_mp4(episode, tmp_path):
    pytest.importorskip("imageio_ffmpeg", reason="needs the extra `video`")
    save_animation(episode(), tmp_path / "case.mp4")
    assert (tmp_path / "case.mp4").read_bytes()[4:8] == b"ftyp"


def test_an_mp4_is_white_to_its_edges(tmp_path):
    pytest.importorskip("imageio_ffmpeg", reason="needs the extra `video`")
    from imageio_ffmpeg import read_frames

    path = tmp_path / "odd.mp4"
    _write(new_figure(301 / 90, 201 / 90), lambda step: [], 2, 0.5, path)  # 90 pixels an inch
    frames = read_frames(str(path))
    width, height = next(frames)["size"]
    shown = np.frombuffer(next(frames), np.uint8).reshape(height, width, 3)
    assert (width % 2, height % 2) == (0, 0)
    assert shown.min() > 250


def test_other_formats_are_refused(episode, tmp_path):
    with pytest.raises(ValueError, match=r"gif.*mp4"):
        save_animation(episode(), tmp_path / "case.avi")
