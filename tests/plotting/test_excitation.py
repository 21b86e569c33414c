"""The figure of errors by how hard the human rode."""

import math

import numpy as np
import pandas as pd
import pytest

from diffstack_mmv.plotting import draw_by_excitation


@pytest.mark.parametrize("known", [True, False])
def test_a_bar_is_drawn_where_its_interval_is_known_and_only_there(known):
    part = pd.DataFrame({"recording": "one", "mode": "bicycle", "speed": np.arange(30.0)})
    part["kbm"] = 0.1 * part["speed"]

    def interval(values, recordings):
        spread = 0.5 if known else math.nan
        return values.mean() - spread, values.mean() + spread

    figure = draw_by_excitation({"sites": part}, ["kbm"], {"speed": "speed"}, "ADE [m]", interval)
    [axes] = figure.axes
    [drawn] = axes.containers
    line, caps, [bars] = drawn.lines
    heights = [np.ptp(bar[:, 1]) for bar in bars.get_segments() if len(bar)]
    assert np.isfinite(line.get_ydata()).all()
    assert np.isfinite(axes.get_ylim()).all()
    assert all(np.isfinite(cap.get_ydata()).all() == known for cap in caps)
    np.testing.assert_allclose(heights, 1.0 if known else math.nan)
