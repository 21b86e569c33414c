"""What all tables share."""

import numpy as np
import pandas as pd
import pytest

from diffstack_mmv.metrics import OPEN_LOOP
from diffstack_mmv.reporting.metrics_table import baseline_table
from diffstack_mmv.reporting.table import (
    NONE,
    cell,
    known_mean,
    markdown_table,
    mean_std,
    with_interval,
    write_table,
)


@pytest.mark.parametrize(
    ("value", "told"),
    [(None, NONE), (float("nan"), NONE), (np.float32(0.5), "0.500"), (3, "3"), ("kbm", "kbm")],
)
def test_a_value_is_told_or_a_dash(value, told):
    assert cell(value) == told


def test_a_number_has_the_form_that_is_asked_for():
    assert (cell(0.25, "+.1f"), cell(1e-9, ".3g")) == ("+0.2", "1e-09")


@pytest.mark.parametrize(
    ("values", "told"),
    [([], NONE), ([0.41], "0.410"), ([1.0, 3.0], "2.000 ± 1.414"), (np.ones(2), "1.000 ± 0.000")],
)
def test_the_deviation_is_that_of_the_sample_and_needs_two_values(values, told):
    assert mean_std(values) == told


@pytest.mark.parametrize(("known", "mean"), [([], np.nan), ([0.5], 0.5), ([1.0, 2.0, 6.0], 3.0)])
def test_the_mean_of_nothing_is_no_number(known, mean) -> None:
    assert known_mean(np.array(known)) == pytest.approx(mean, nan_ok=True)


@pytest.mark.parametrize(
    ("value", "interval", "told"),
    [(0.5, (0.25, 0.75), "0.500 [0.250, 0.750]"), (None, [0.0, 1.0], "– [0.000, 1.000]")],
)
def test_an_interval_stands_in_brackets_even_around_nothing(value, interval, told):
    assert with_interval(value, interval) == told


def test_a_table_is_written_thrice(tmp_path):
    write_table(tmp_path, "table", pd.DataFrame({"share [%]": ["1"]}), "text\n")
    assert (tmp_path / "table.md").read_text() == "text\n"
    assert r"share [\%]" in (tmp_path / "table.tex").read_text()
    assert (tmp_path / "table.csv").read_text() == "share [%]\n1\n"


def test_text_of_a_markdown_table_stays_as_it_is_and_numbers_have_their_form():
    table = pd.DataFrame({"told": ["0.410", "+0.8333"], "number": [0.5, None], "n": [3, 10]})
    lines = [line.split() for line in markdown_table(table, ".2f").splitlines()[2:]]
    assert lines[0] == ["|", "0.410", "|", "0.50", "|", "3", "|"]
    assert lines[1] == ["|", "+0.8333", "|", "–", "|", "10", "|"]


def test_the_most_likely_path_and_the_median_stand_beside_the_baselines():
    own = {"ade": 3.0, "fde": 6.0, "median_ade": 2.0, "median_fde": 4.0}
    trivial = {"kalman": {"bicycle": {"ade": 5.0, "fde": 9.0}}}
    table = baseline_table({"modes": {"bicycle": own}, "baselines": trivial}, OPEN_LOOP)
    assert table["bicycle ADE"].to_dict() == {
        "prediction (most likely)": 3.0,
        "prediction (median)": 2.0,
        "kalman": 5.0,
    }
