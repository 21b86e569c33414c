"""The figures of an evaluation take the place of those of the one before."""

import numpy as np
import pytest

from diffstack_mmv.plotting import PLANS_FILE, remove_evaluation, save_evaluation


@pytest.fixture
def drawn(tmp_path):
    levels = {"bicycle": np.linspace(0, 1, 20)}
    save_evaluation(tmp_path, levels, {"bicycle": {"plan": np.arange(5.0)}}, 0.1, "ADE [m]")
    return tmp_path


def test_figures_of_regions_and_errors_are_written(drawn):
    assert {file.name for file in drawn.iterdir()} == {"reliability.png", "error_over_horizon.png"}
    assert all(file.stat().st_size > 1000 for file in drawn.iterdir())


@pytest.mark.parametrize("mode", ["bicycle", "scooter"])
def test_figures_of_an_earlier_evaluation_are_removed_and_nothing_else(drawn, mode):
    (drawn / PLANS_FILE.format(mode=mode)).touch()
    (drawn / "metrics.json").touch()
    remove_evaluation(drawn)
    assert [file.name for file in drawn.iterdir()] == ["metrics.json"]
    remove_evaluation(drawn)
