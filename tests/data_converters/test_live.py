"""Tracks as they come in, sampled up to now."""

import numpy as np
import pandas as pd
import pytest

from data_converters import (
    CausalSmoother,
    LiveTracks,
    RecordingLimits,
    ResampleSettings,
    ZeroPhaseSmoother,
)
from data_converters.resampling import resample
from data_converters.tracks import RawTrack
from dmmv_conventions.modes import Mode

TIME_S = np.arange(0.0, 6.01, 0.08)


def samples(name="me", mode="bicycle", time_s=TIME_S, shift=0.0, **columns):
    """A weaving ride, seen with noise."""
    noise = np.random.default_rng(len(name)).normal(0.0, 0.03, (len(time_s), 2))
    x, y = 4.0 * time_s + shift + noise[:, 0], np.sin(time_s) + noise[:, 1]
    table = {"time": time_s, "agent": name, "mode": mode, "x": x, "y": y}
    return pd.DataFrame(table | columns)


def test_rows_are_those_of_a_conversion():
    table, now_s = samples(), 4.8
    place = np.column_stack([table[["x", "y"]], np.zeros(len(table))])
    track = RawTrack("me", Mode.BICYCLE, TIME_S, place, "here")
    converted = resample(track, ResampleSettings())
    last = 48 - converted.first_step + 1
    rows = converted.rows.iloc[last - 41 : last]
    seen = LiveTracks()(table, "me", now_s=now_s)
    assert np.allclose(seen.position[0], rows[["x", "y"]], atol=1e-9)
    assert np.allclose(seen.velocity[0], rows[["vx", "vy"]], atol=1e-9)
    assert np.allclose(seen.heading[0], rows["heading"], atol=1e-9)


def test_neither_the_order_of_the_rows_nor_the_origin_of_the_clock_counts():
    table = pd.concat([samples(), samples("other", "pedestrian", shift=9.0)])
    seen = LiveTracks()(table, "me")
    mixed = table.sample(frac=1.0, random_state=0).assign(time=lambda rows: rows["time"] + 1.7e9)
    again = LiveTracks()(mixed, "me")
    assert seen.names == again.names == ("me", "other")
    assert seen.modes == ("bicycle", "pedestrian")
    assert np.allclose(seen.position, again.position, atol=1e-4)


@pytest.mark.parametrize("ego", [7, "7"])
def test_agents_may_be_numbers(ego):
    table = pd.concat([samples().assign(agent=12), samples().assign(agent=7)])
    assert LiveTracks()(table, ego).names == ("7", "12")


def test_later_samples_are_not_looked_at():
    table = samples()
    before = LiveTracks()(table[table["time"] <= 4.0], "me", now_s=4.0)
    after = LiveTracks()(
        table.assign(x=np.where(table["time"] > 4.0, 1e3, table["x"])), "me", now_s=4.0
    )
    assert np.array_equal(before.position, after.position, equal_nan=True)


@pytest.mark.parametrize(
    ("late_s", "present"), [(0.0, True), (0.08, True), (0.16, False), (3.0, False)]
)
def test_who_was_seen_just_before_now_is_present(late_s, present):
    late = samples("late", "scooter", TIME_S[TIME_S[-1] - TIME_S >= late_s - 1e-6])
    seen = LiveTracks()(pd.concat([samples(), late]), "me")
    assert ("late" in seen.names) == present


def test_how_late_somebody_may_be_is_a_setting():
    late = samples("late", time_s=TIME_S[TIME_S <= 5.2])
    table = pd.concat([samples(), late])
    for strict in (LiveTracks(), LiveTracks(late_s=0.0)):
        assert strict(table, "me").names == ("me",)
    assert LiveTracks(late_s=1.0)(table, "me").names == ("me", "late")


def test_now_is_when_the_ego_was_seen_last():
    table = pd.concat([samples("other"), samples(time_s=TIME_S[TIME_S <= 4.0])])
    seen = LiveTracks()(table, "me")
    assert seen.names == ("me", "other"), "the ego comes first, wherever it stands in the table"
    told = LiveTracks()(table, "me", now_s=TIME_S[TIME_S <= 4.0][-1])
    np.testing.assert_array_equal(seen.position, told.position)
    assert abs(seen.position[1, -1, 0] - 16.0) < 0.2


@pytest.mark.parametrize("history_s", [0.1, 2.0])
def test_a_shorter_history_is_the_end_of_a_longer_one(history_s):
    whole, short = (LiveTracks()(samples(), "me", each) for each in (4.0, history_s))
    rows = round(history_s / 0.1) + 1
    assert short.heading.shape == (1, rows)
    for name in ("position", "velocity", "heading"):
        np.testing.assert_array_equal(getattr(short, name), getattr(whole, name)[:, -rows:])


def test_who_is_late_moves_on():
    late = samples("late", time_s=TIME_S[:-1])
    seen = LiveTracks()(pd.concat([samples(), late]), "me")
    assert abs(seen.position[1, -1, 0] - 4.0 * TIME_S[-1]) < 0.1


def test_a_track_begins_after_its_last_gap():
    table = samples()
    gap = table[(table["time"] < 2.0) | (table["time"] > 3.0)]
    seen = LiveTracks()(gap, "me")
    known = np.isfinite(seen.position[0, :, 0])
    assert known.sum() == int(np.floor((TIME_S[-1] - 3.04 - 0.6) / 0.1 + 1e-6)) + 1
    assert known[-1]


def test_whoever_has_not_moved_yet_has_no_course():
    still = samples().assign(x=1.0, y=2.0)
    assert (LiveTracks()(still, "me").heading == 0).all()


@pytest.mark.parametrize(
    ("given", "size"),
    [
        ({}, (1.8, 0.6)),
        ({"length": 2.5, "width": 0.9}, (2.5, 0.9)),
        ({"length": np.nan, "width": np.nan}, (1.8, 0.6)),
        ({"length": [2.5, *[np.nan] * 75], "width": np.nan}, (2.5, 0.6)),
    ],
)
def test_a_size_that_was_not_measured_is_that_of_the_mode(given, size):
    assert tuple(LiveTracks()(samples(**given), "me").extent[0]) == size


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda rows: rows.drop(columns="x"), "`table` must have the columns time, agent, mode"),
        (lambda rows: rows.assign(x="a"), "`x` must hold numbers"),
        (lambda rows: rows.assign(y=np.nan), "`y` must be finite in all rows, but got '76 that"),
        (
            lambda rows: rows.assign(time=1.0),
            "`time` must differ from sample to sample, but got '75 rep",
        ),
        (lambda rows: rows.assign(mode="bike"), "`mode` must be one of bicycle"),
        (
            lambda rows: rows.assign(mode=["bicycle", *["car"] * 75]),
            "`mode` must be the same in all rows, but got 'bicycle and car'",
        ),
        (lambda rows: rows.assign(length=np.inf, width=1.0), "`length` must be finite in all rows"),
        (lambda rows: rows.assign(length=0.0, width=1.0), "`length, width` must be positive"),
        (
            lambda rows: rows.assign(agent=["me", None, *["me"] * 74]),
            "`agent` must be given in all rows, but got '1 without'",
        ),
        (lambda rows: rows.assign(agent="you"), "`ego` must be an agent of the table, such as you"),
        (lambda rows: rows[:3], "`ego` must be observed for 0.6 s and more"),
        (lambda rows: rows[:0], "`ego` must be an agent of the table, such as no agents"),
    ],
)
def test_what_cannot_be_used_is_told(change, told):
    with pytest.raises(ValueError, match=told):
        LiveTracks()(change(samples()), "me")


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("table", [None, [], {}, np.zeros((3, 5)), pd.Series([1.0])])
def test_what_is_no_table_is_refused(table):
    with pytest.raises(ValueError, match="`table` must be a DataFrame of pandas, but got .* Make"):
        LiveTracks()(table, "me")


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("now_s", ["6", np.nan])
def test_the_present_is_a_time(now_s):
    with pytest.raises(ValueError, match="`now_s` must be a finite time in s"):
        LiveTracks()(samples(), "me", now_s=now_s)


@pytest.mark.parametrize(
    ("metres", "unit"), [(1e2, "cm"), (1e3, "mm")], ids=["centimetres", "millimetres"]
)
def test_positions_in_another_unit_are_told_with_agent_speed_and_unit(metres, unit):
    table = samples("me", "scooter")
    table = table.assign(x=metres * table["x"], y=metres * table["y"])
    told = f"most 30 m/s for mode 'scooter', .* in the track of 'me'.*positions were in {unit}"
    with pytest.raises(ValueError, match=f"`speed` must be at {told}"):
        LiveTracks()(table, "me")


@pytest.mark.parametrize(("unit", "step"), [(1e3, "80 s"), (1e6, "80000 s"), (1e9, r"8e\+07 s")])
def test_times_in_another_unit_are_told_with_agent_and_step(unit, step):
    table = pd.concat([samples(), samples("other")])
    told = f"`time` must rise by at most 0.5 s .* got '{step} as a rule' in the track of 'me'"
    with pytest.raises(ValueError, match=told):
        LiveTracks()(table.assign(time=unit * table["time"]), "me")


def test_times_in_milliseconds_are_told_to_who_gives_the_present_in_them_too():
    """The last sample then lies tens of seconds back: the ego would be absent."""
    table = samples().assign(time=1e3 * TIME_S)
    with pytest.raises(ValueError, match="`time` must rise by at most .* in the track of 'me'"):
        LiveTracks()(table, "me", now_s=1e3 * TIME_S[-1] + 40.0)


def test_a_jump_parts_a_track_as_a_gap_does():
    table = samples()
    jump = table.assign(x=table["x"] + 9.0 * (table["time"] > 2.0))
    parted = jump[jump["time"] > 2.0]
    for whole, after in zip(LiveTracks()(jump, "me"), LiveTracks()(parted, "me"), strict=True):
        np.testing.assert_array_equal(whole, after)
    believed = LiveTracks(limits=RecordingLimits(slack_m=10.0, speed_mps={"bicycle": 300.0}))
    assert (
        np.isfinite(believed(jump, "me").position).sum()
        > np.isfinite(LiveTracks()(jump, "me").position).sum()
    )


@pytest.mark.parametrize("back", [1, 2, 9], ids=["last", "last but one", "earlier"])
def test_a_stray_sample_is_left_out(back):
    """Nobody vanishes, and nobody speeds away, because of one of them."""
    table = samples()
    stray = table.copy()
    row = stray.index[stray["time"].argsort().iloc[-back]]
    stray.loc[row, "x"] += 8.0
    now = table["time"].max()
    found, without = (
        LiveTracks()(rows, "me", now_s=now) for rows in (stray, stray.drop(index=row))
    )
    for one, other in zip(found, without, strict=True):
        np.testing.assert_array_equal(one, other)


WALKER = samples("other", "pedestrian")


@pytest.mark.parametrize(
    ("others", "names"),
    [
        (WALKER.tail(2).assign(x=[0.0, 20.0]), ("me",)),
        (WALKER.assign(x=WALKER["x"] + 30.0 * (np.arange(len(WALKER)) % 3 == 0)), ("me", "other")),
        (WALKER.assign(x=17.0 * WALKER["time"]), ("me", "other")),
        (WALKER.head(5).assign(mode="drone"), ("me",)),
    ],
    ids=["two far samples", "flickering", "as fast as a moped", "of an unknown mode"],
)
def test_what_a_tracker_makes_of_others_ends_no_decision(others, names):
    found = LiveTracks()(pd.concat([samples(), others]), "me")
    np.testing.assert_array_equal(found.position[0], LiveTracks()(samples(), "me").position[0])
    assert found.names == names


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"settings": ResampleSettings(smoother=ZeroPhaseSmoother())}, "`smoother` must not look"),
        ({"late_s": -0.1}, "`late_s` must be at least 0"),
        ({"late_s": None}, "`late_s` must be at least 0"),
        ({"settings": None}, "`settings` must be ResampleSettings, but got 'NoneType'"),
        ({"limits": {}}, "`limits` must be RecordingLimits, but got 'dict'"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings, told):
    with pytest.raises(ValueError, match=told):
        LiveTracks(**settings)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("history_s", [0.0, 0.25, np.inf, "4", None])
def test_the_history_is_a_multiple_of_the_step(history_s):
    tracks = LiveTracks(ResampleSettings(smoother=CausalSmoother()))
    with pytest.raises(ValueError, match="`history_s` must be a multiple of 0.1 s"):
        tracks(samples(), "me", history_s=history_s)
