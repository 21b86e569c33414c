"""What was recorded beside a track, behind the smoother of the track."""

import numpy as np
import pytest

from data_converters import (
    CausalSmoother,
    ConversionError,
    Unsmoothed,
    ZeroPhaseSmoother,
    smoothed_beside,
    smoother_of,
)

STEP_S = 0.1


@pytest.mark.parametrize(
    "smoother", [CausalSmoother(0.8), Unsmoothed(), ZeroPhaseSmoother(0.7)], ids=str
)
def test_smoother_is_built_from_what_a_cache_holds(smoother):
    assert smoother_of(smoother.settings()) == smoother


def test_unknown_smoother_is_refused():
    with pytest.raises(ConversionError, match="`smoother` must be one of CausalSmoother"):
        smoother_of({"name": "Median", "lookahead_s": 0.0})


def test_each_run_is_smoothed_by_itself():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(40, 2))
    values[20:22] = np.nan
    values[37] = np.nan  # the two rows after it are too few
    smoother, time_s = ZeroPhaseSmoother(), STEP_S * np.arange(20)
    found = smoothed_beside(smoother, values, STEP_S)
    np.testing.assert_array_equal(found[:20], smoother(time_s, values[:20], time_s).value)
    assert np.isfinite(found[22:37]).all()
    assert np.isnan(found[[20, 21, 37, 38, 39]]).all()


def test_causal_smoother_knows_nothing_in_its_warm_up():
    found = smoothed_beside(CausalSmoother(), np.ones((30, 1)), STEP_S)
    assert np.isnan(found[:6]).all()
    np.testing.assert_allclose(found[6:], 1.0)


def test_samples_as_they_are_stay():
    values = np.random.default_rng(1).normal(size=(20, 2))
    np.testing.assert_array_equal(smoothed_beside(Unsmoothed(), values, STEP_S), values)
