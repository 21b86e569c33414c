"""The reliability plot: what it shows of levels, and what it does not."""

import numpy as np

from diffstack_mmv.plotting import draw_reliability


def lines(levels):
    _, *modes = draw_reliability(levels).axes[0].get_lines()
    return {line.get_label(): np.asarray(line.get_xydata()) for line in modes}


def test_a_calibrated_forecast_lies_on_the_diagonal():
    drawn = lines({"bicycle": (np.arange(4000) + 0.5) / 4000})["bicycle"]
    np.testing.assert_allclose(drawn[:, 1], drawn[:, 0], atol=1e-3)


def test_truths_beyond_all_samples_are_not_told_to_miss_the_whole_plane():
    drawn = lines({"bicycle": np.array([0.2, 1.7]), "scooter": np.array([0.9])})
    assert drawn["bicycle"][:, 1].max() == 0.5
    assert all(line[0, 0] > 0 and line[-1, 0] < 1 for line in drawn.values())
