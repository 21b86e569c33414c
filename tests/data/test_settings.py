"""Settings of windows, and the count of what becomes of each row."""

import pytest

from diffstack_mmv.data import WindowSettings
from diffstack_mmv.data.window_counts import WindowCounts
from diffstack_mmv.types import Mode


def test_four_seconds_past_and_three_future_are_41_and_30_rows():
    settings = WindowSettings()
    assert (settings.past_rows, settings.future_rows, settings.rows) == (41, 30, 71)


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        ({"history_s": 4.05}, "`history_s` must be a multiple of 0.1, but got 4.05"),
        ({"horizon_s": 0.0}, "`horizon_s` must be positive"),
        ({"ego_modes": ("unicorn",)}, "`ego_modes` must be one of .*'unicorn'"),
        ({"ego_modes": ()}, "`ego_modes` must name at least one mode"),
        ({"stride": 0}, "`stride` must be at least 1"),
        ({"radius_m": -1.0}, "`radius_m` must be positive"),
        ({"neighbors": -1}, "`neighbors` must be at least 0"),
        ({"dt_s": 0.0}, "`dt_s` must be positive"),
    ],
)
def test_wrong_settings_are_refused(wrong, complaint):
    with pytest.raises(ValueError, match=complaint):
        WindowSettings(**wrong)


@pytest.mark.parametrize("rows", [1, 70, 71, 75, 76, 200])
@pytest.mark.parametrize("mode", [Mode.BICYCLE, Mode.CAR])
def test_every_row_has_one_fate(rows, mode):
    counts = WindowCounts(WindowSettings())
    counts.add(mode, rows)
    assert sum(counts.as_dict()[mode.label].values()) == rows


@pytest.mark.parametrize(("rows", "kept"), [(70, 0), (71, 1), (75, 1), (76, 2), (171, 21)])
def test_windows_are_counted_at_the_stride(rows, kept):
    counts = WindowCounts(WindowSettings())
    counts.add(Mode.BICYCLE, rows)
    assert counts.as_dict()["bicycle"].get("window", 0) == kept


@pytest.mark.parametrize(
    ("mode", "rows", "fates"),
    [
        (Mode.CAR, 71, {"mode_is_no_ego_mode": 71}),
        (Mode.BICYCLE, 70, {"track_shorter_than_a_window": 70}),
        (
            Mode.BICYCLE,
            84,  # presents of full windows are rows 40 to 53: 40, 45 and 50 at the stride
            {"no_full_history": 40, "no_full_future": 30, "between_strides": 11, "window": 3},
        ),
    ],
)
def test_rows_are_counted_by_what_they_lack(mode, rows, fates):
    counts = WindowCounts(WindowSettings())
    counts.add(mode, rows)
    found = counts.as_dict()[mode.label]
    assert {fate: count for fate, count in found.items() if count} == fates


def test_windows_that_are_not_finite_are_counted_as_such_and_as_no_windows():
    counts = WindowCounts(WindowSettings())
    counts.add(Mode.BICYCLE, 171)
    counts.add(Mode.BICYCLE, 71)
    counts.drop(Mode.BICYCLE, 4)
    counts.drop(Mode.BICYCLE, 1)
    found = counts.as_dict()["bicycle"]
    assert (found["window"], found["not_finite"]) == (22 - 5, 5)
    assert sum(found.values()) == 171 + 71


@pytest.mark.parametrize("dropped", [0, 1])
def test_a_data_set_whose_windows_are_all_dropped_is_refused(dropped):
    counts = WindowCounts(WindowSettings())
    counts.add(Mode.BICYCLE, 71)
    counts.add(Mode.CAR, 90)
    counts.drop(Mode.BICYCLE, dropped)
    if not dropped:
        counts.require_windows("toy")
        return
    with pytest.raises(ValueError, match=r"1 rows not_finite.*other modes: car in 'toy'"):
        counts.require_windows("toy")
